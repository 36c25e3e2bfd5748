//! octtrace: answers rays from standard input.

#[path = "../cli/mod.rs"]
mod cli;
mod stream;

use std::io::IsTerminal;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use clap::Parser;
use octrace::geometry::{Hit, Ray};
use octrace::map::Octree;
use octrace::trace::{Counters, Isa, OctreeTracer, Tracer};
use octrace::{Error, Result};
use serde::Serialize;

use cli::args::{Common, StatsFile};
use cli::reading::{self, Reading};
use cli::stats::Pages;
use cli::{Arguments, Session};
use stream::RayReader;

/// Rays that are read, traced and written at a time, fewest and most.
const BATCHES: [usize; 2] = [1 << 14, 1 << 18];
/// Bytes of a ray, its answer, and what it takes while it waits for a page.
const RAY_BYTES: u64 = 48 + 128;

/// Answers rays: reads them from standard input, writes a hit for each to standard output
#[derive(Parser)]
#[command(name = "octtrace", version, after_help = EXAMPLES, override_usage = "octtrace [OPTIONS] MODEL.oct < RAYS > HITS")]
struct Args {
    /// The octree file
    #[arg(value_name = "MODEL.oct")]
    model: PathBuf,
    /// Only say whether anything is hit: one byte a ray, 1 = blocked
    #[arg(long)]
    any: bool,
    /// Trace the whole set N times and write it once, to measure
    ///
    /// Holds all rays in memory.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    repeat: u32,
    /// Instruction set to trace with: auto, scalar, avx2 or avx512
    ///
    /// The hits are the same, bit for bit.
    #[arg(long, value_name = "SET", default_value = "auto", value_parser = isa)]
    isa: Isa,
    #[command(flatten)]
    reading: Reading,
    #[command(flatten)]
    common: Common,
    #[command(flatten)]
    stats: StatsFile,
}

const EXAMPLES: &str = "\
A ray is 32 bytes: 8 little-endian f32 (origin, direction, tmin, tmax).
A hit is 16 bytes: f32 t, u32 face, f32 u, f32 v, with the point (1-u-v) v0 + u v1 + v v2;
a miss has t = infinity and face = 0xFFFFFFFF.

Examples:
  octbench mesh -n 1e5 -o planet.obj                  a mesh to try things with
  octbuild planet.obj -o planet.oct
  octbench speed planet.oct --rounds 1 --keep-rays rays
                                                      and rays: the folder of that name gets some sets
  octtrace planet.oct < rays/chords.rays > hits.bin
  octtrace planet.oct --any < rays/chords.rays > blocked.bin
  octtrace planet.oct --memory 128M < rays/chords.rays > hits.bin
                                                      a file of any size, never above 128 MiB of memory
  octtrace planet.oct --repeat 9 --threads 1 --stats speed.json < rays/chords.rays > hits.bin
";

/// The statistics file.
#[derive(Default, Serialize)]
struct Stats {
    schema: u32,
    rays: u64,
    hits: u64,
    trace_seconds: Vec<f64>,
    mrays_per_second: f64,
    nodes_per_ray: f64,
    triangles_per_ray: f64,
    pages: Pages,
    peak_rss_bytes: u64,
}

impl Arguments for Args {
    fn common(&self) -> &Common {
        &self.common
    }
}

fn main() -> ExitCode {
    cli::run(work)
}

fn work(args: &Args, session: &Session<'_>) -> Result<ExitCode> {
    args.stats.not_stdout("the hits")?;
    args.stats.check()?;
    let (octree, batch) = open(args, session)?;
    if std::io::stdin().is_terminal() {
        return Err(Error::Option("standard input is a terminal; give rays: octtrace MODEL.oct < RAYS > HITS".into()));
    }
    let tracer = OctreeTracer::new(&octree).with_isa(args.isa);
    let mut run = Run { tracer, session, batch, work: Counters::default(), rays: 0, hits: 0 };
    let seconds = if args.any {
        run.all(args.repeat, false, Tracer::any_batch, |&blocked| blocked)?
    } else {
        run.all(args.repeat, Hit::MISS, Tracer::closest_batch, Hit::is_hit)?
    };
    session.finish();
    args.stats.write(&run.stats(seconds))?;
    Ok(ExitCode::SUCCESS)
}

/// Opens the file; how many rays to trace at a time.
fn open(args: &Args, session: &Session<'_>) -> Result<(Octree, usize)> {
    let (mut octrees, bound) = reading::open(&[&args.model], &args.reading)?;
    let octree = octrees.remove(0);
    let Some(memory) = bound else { return Ok((octree, BATCHES[1])) };
    if args.repeat > 1 && args.reading.memory.is_some() {
        return Err(Error::Option("--repeat holds all rays in memory, so it does not go with --memory".into()));
    }
    let header = *octree.header();
    let need = octree.least() + BATCHES[0] as u64 * RAY_BYTES;
    let left = reading::left_of(memory, &[header]).map_err(|taken| reading::too_small(taken + need))?;
    let rest = left.checked_sub(need).ok_or_else(|| reading::too_small(memory - left + need))?;
    let mut batch = BATCHES[0];
    while batch < BATCHES[1] && 2 * batch as u64 * RAY_BYTES <= BATCHES[0] as u64 * RAY_BYTES + rest / 4 {
        batch *= 2;
    }
    octree.set_cache(left - batch as u64 * RAY_BYTES);
    reading::warning(&args.model, &header, memory).into_iter().for_each(|text| session.monitor().warn(text));
    Ok((octree, batch))
}

/// An instruction set by its name.
fn isa(name: &str) -> std::result::Result<Isa, String> {
    if name == "auto" {
        return Ok(Isa::best());
    }
    Isa::named(name).ok_or_else(|| {
        let names: Vec<_> = Isa::available().into_iter().map(Isa::name).collect();
        format!("this processor has auto, {}", names.join(", "))
    })
}

/// One run of the program.
struct Run<'a> {
    tracer: OctreeTracer<&'a Octree>,
    session: &'a Session<'a>,
    /// Rays at a time.
    batch: usize,
    work: Counters,
    rays: u64,
    hits: u64,
}

impl<'a> Run<'a> {
    /// Answers all rays of standard input; the seconds that each repeat took.
    fn all<T: bytemuck::NoUninit>(
        &mut self,
        repeat: u32,
        blank: T,
        trace: impl Fn(&OctreeTracer<&'a Octree>, &[Ray], &mut [T]) -> Result<Counters>,
        is_hit: impl Fn(&T) -> bool,
    ) -> Result<Vec<f64>> {
        self.session.monitor().phase("trace");
        let mut reader = RayReader::new(std::io::stdin().lock());
        let mut out = std::io::stdout().lock();
        let mut seconds = vec![0.0; repeat as usize];
        if repeat == 1 {
            let mut rays = vec![stream::NO_RAY; self.batch];
            let mut answers = vec![blank; rays.len()];
            loop {
                let n = reader.fill(&mut rays)?;
                if n == 0 {
                    break;
                }
                seconds[0] += self.time(&trace, &rays[..n], &mut answers[..n])?;
                self.count(&answers[..n], &is_hit);
                stream::write(&mut out, &answers[..n])?;
            }
        } else {
            let rays = reader.read_all(self.batch)?;
            let mut answers = vec![blank; rays.len()];
            for (done, seconds) in seconds.iter_mut().enumerate() {
                for (rays, answers) in rays.chunks(self.batch).zip(answers.chunks_mut(self.batch)) {
                    *seconds += self.time(&trace, rays, answers)?;
                }
                self.session.monitor().progress(done as u64 + 1, Some(repeat.into()), "repeats");
            }
            self.count(&answers, &is_hit);
            stream::write(&mut out, &answers)?;
        }
        stream::flush(&mut out)?;
        Ok(seconds)
    }

    /// Traces a batch; the seconds it took.
    fn time<T>(
        &mut self,
        trace: impl Fn(&OctreeTracer<&'a Octree>, &[Ray], &mut [T]) -> Result<Counters>,
        rays: &[Ray],
        answers: &mut [T],
    ) -> Result<f64> {
        self.session.monitor().check()?;
        let start = Instant::now();
        self.work = self.work + trace(&self.tracer, rays, answers)?;
        let seconds = start.elapsed().as_secs_f64();
        self.tracer.octree().fault()?;
        Ok(seconds)
    }

    fn count<T>(&mut self, answers: &[T], is_hit: impl Fn(&T) -> bool) {
        self.rays += answers.len() as u64;
        self.hits += answers.iter().filter(|a| is_hit(a)).count() as u64;
        self.session.monitor().progress(self.rays, None, "rays");
    }

    fn stats(&self, trace_seconds: Vec<f64>) -> Stats {
        let per_ray = |n: u64| n as f64 / self.work.rays.max(1) as f64;
        let seconds = median(&trace_seconds);
        Stats {
            schema: cli::stats::SCHEMA,
            rays: self.rays,
            hits: self.hits,
            mrays_per_second: if seconds > 0.0 { self.rays as f64 / seconds * 1e-6 } else { 0.0 },
            nodes_per_ray: per_ray(self.work.nodes),
            triangles_per_ray: per_ray(self.work.triangles),
            pages: Pages::of([self.tracer.octree().figures()]),
            peak_rss_bytes: cli::stats::peak_rss_bytes(),
            trace_seconds,
        }
    }
}

/// The median; of an even number of values the mean of the middle two; 0 of none.
fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match sorted.len() {
        0 => 0.0,
        n if n % 2 == 1 => sorted[n / 2],
        n => (sorted[n / 2 - 1] + sorted[n / 2]) / 2.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_arguments_are_consistent() {
        Args::command().debug_assert();
    }

    #[test]
    fn medians() {
        assert_eq!(median(&[]), 0.0);
        assert_eq!(median(&[3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&[4.0, 1.0, 2.0, 3.0]), 2.5);
    }
}
