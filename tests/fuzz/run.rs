//! Throws hostile input at the library for as long as is asked: `cargo run --release --example fuzz -- --inputs 1000000`.
//!
//! Inputs are numbered, and a number gives the same input for ever, so that what fails is told by its number and kept in tests/fuzz/corpus.
//! They run in child processes: one that dies, hangs for ten seconds or takes more memory than it may is told, and the rest goes on behind it.

#[path = "mod.rs"]
#[allow(dead_code)]
mod fuzz;

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use clap::Parser;
use fuzz::seeds::{self, Seeds};
use fuzz::targets::{self, Outcome, TARGETS};
use fuzz::text;

/// Longest that an input may take.
const PATIENCE: Duration = Duration::from_secs(10);
/// Most memory that a process may take, whatever it reads.
const MEMORY: u64 = 512 << 20;

/// Throws hostile input at the library
#[derive(Parser)]
struct Args {
    /// Inputs in all, shared out among the targets: half of them octree files
    #[arg(long, default_value_t = 100_000)]
    inputs: u64,
    /// Only this target: obj, mtl, ply, stl, archive, texture, scene, oct, rays or resume
    #[arg(long)]
    target: Option<String>,
    /// Number of the first input
    #[arg(long, default_value_t = 0)]
    first: u64,
    /// Stop after so many seconds
    #[arg(long)]
    seconds: Option<u64>,
    /// Processes
    #[arg(long, default_value_t = 2)]
    processes: usize,
    /// Folder for inputs that fail
    #[arg(long, default_value = "tests/fuzz/corpus")]
    keep: PathBuf,
    /// One input, given as a file, to the target
    #[arg(long)]
    file: Option<PathBuf>,
    /// Write the inputs into this folder, a folder a target, with a dictionary TARGET.dict of those that are text, and do
    /// nothing else with them
    #[arg(long)]
    seeds: Option<PathBuf>,
    #[arg(long, hide = true)]
    child: bool,
}

fn main() -> ExitCode {
    let args = Args::parse();
    if args.child {
        child(&args);
        return ExitCode::SUCCESS;
    }
    if let Some(file) = &args.file {
        let target = targets::named(args.target.as_deref().expect("--file needs --target"));
        let folder = tempfile::tempdir().unwrap();
        println!("{:?}", (target.run)(&std::fs::read(file).unwrap(), folder.path()));
        return ExitCode::SUCCESS;
    }
    if let Some(folder) = &args.seeds {
        write_seeds(&args, folder);
        return ExitCode::SUCCESS;
    }
    parent(&args)
}

/// Writes inputs for others to begin with.
fn write_seeds(args: &Args, folder: &Path) {
    let scratch = tempfile::tempdir().unwrap();
    let seeds = Seeds::new(scratch.path());
    for target in TARGETS.iter().filter(|t| args.target.as_deref().is_none_or(|name| name == t.name)) {
        let place = folder.join(target.name);
        std::fs::create_dir_all(&place).unwrap();
        for (i, whole) in seeds.whole(target.name, scratch.path()).iter().enumerate() {
            std::fs::write(place.join(format!("whole_{i}")), whole).unwrap();
        }
        for number in args.first..args.first + args.inputs {
            std::fs::write(place.join(number.to_string()), seeds.input(target.name, number)).unwrap();
        }
        let words = seeds::words(target.name);
        if !words.is_empty() {
            let lines: String = words.iter().chain(&text::NUMBERS).map(|word| format!("\"{word}\"\n")).collect();
            std::fs::write(folder.join(target.name).with_extension("dict"), lines).unwrap();
        }
    }
}

/// The share of each target in a hundred inputs.
fn share(name: &str) -> u64 {
    match name {
        "oct" => 50,
        "obj" => 13,
        "scene" => 9,
        _ => 4,
    }
}

/// Shares the work out and gathers what is found.
fn parent(args: &Args) -> ExitCode {
    let begin = Instant::now();
    let end = args.seconds.map(|s| begin + Duration::from_secs(s));
    let mut jobs = Vec::new();
    for target in TARGETS.iter().filter(|t| args.target.as_deref().is_none_or(|name| name == t.name)) {
        let count = if args.target.is_some() { args.inputs } else { args.inputs * share(target.name) / 100 };
        // Builds take longer than all else.
        let stretch = if target.name == "resume" { 500 } else { 5000 };
        let mut first = args.first;
        while first < args.first + count {
            let last = (first + stretch).min(args.first + count);
            jobs.push((target.name, first, last));
            first = last;
        }
    }
    let (jobs, next) = (Arc::new(jobs), Arc::new(AtomicU64::new(0)));
    let tally = Arc::new(Mutex::new(Tally::default()));
    let worker = || {
        let (jobs, next, tally, keep) = (jobs.clone(), next.clone(), tally.clone(), args.keep.clone());
        std::thread::spawn(move || {
            while let Some(&(name, first, last)) = jobs.get(next.fetch_add(1, Ordering::Relaxed) as usize) {
                if end.is_some_and(|end| Instant::now() > end) {
                    return;
                }
                stretch(name, first, last, &keep, &tally);
            }
        })
    };
    let workers: Vec<_> = (0..args.processes.max(1)).map(|_| worker()).collect();
    workers.into_iter().for_each(|w| w.join().unwrap());
    let tally = tally.lock().unwrap();
    for (name, counts) in &tally.counts {
        let [taken, refused, right] = counts;
        print!("{name}: {} inputs, {taken} taken, {refused} refused", taken + refused);
        match name.as_str() {
            "oct" => println!("; header and checksums of {right} pass"),
            "resume" => println!("; checksums of {right} pass"),
            _ => println!(),
        }
    }
    let inputs: u64 = tally.counts.values().map(|c| c[0] + c[1]).sum();
    println!("{inputs} inputs in {:.0} s: {} failures", begin.elapsed().as_secs_f64(), tally.failures);
    if tally.failures == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

#[derive(Default)]
struct Tally {
    /// Taken, refused, and (octree files, leftovers) of all these how many had a header and checksums that pass; by target.
    counts: std::collections::BTreeMap<String, [u64; 3]>,
    failures: u64,
}

/// Inputs `first..last` of a target, in as many processes as it takes.
fn stretch(name: &str, mut first: u64, last: u64, keep: &Path, tally: &Mutex<Tally>) {
    while first < last {
        let place = tempfile::NamedTempFile::new().unwrap();
        let child = Command::new(std::env::current_exe().unwrap())
            .args(["--child", "--target", name, "--first", &first.to_string(), "--inputs", &(last - first).to_string()])
            .arg("--keep")
            .arg(place.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .output()
            .unwrap();
        let record = std::fs::read(place.path()).unwrap();
        let number = |i: usize| record.get(8 * i..8 * i + 8).map_or(0, |b| u64::from_le_bytes(b.try_into().unwrap()));
        let at = number(0);
        let mut tally = tally.lock().unwrap();
        let counts = tally.counts.entry(name.into()).or_default();
        (0..3).for_each(|i| counts[i] += number(i + 1));
        if child.status.success() {
            return;
        }
        tally.failures += 1;
        let said = String::from_utf8_lossy(&child.stderr);
        if record.is_empty() {
            println!("{name}: the child did not begin: {}", said.trim());
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let input = Seeds::new(folder.path()).input(name, at);
        let file = keep.join(name).join(format!("{at}"));
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(&file, input).unwrap();
        println!("{name} {at}: {} ({})\n{}", child.status, file.display(), said.trim());
        first = at.max(first) + 1;
    }
}

/// Runs inputs one after the other; writes down which before it begins.
fn child(args: &Args) {
    let name = args.target.as_deref().unwrap();
    let target = targets::named(name);
    let folder = tempfile::tempdir().unwrap();
    let seeds = Seeds::new(folder.path());
    let place = std::fs::File::create(&args.keep).unwrap();
    let since = Arc::new(AtomicU64::new(0));
    let (watched, ended) = (since.clone(), Arc::new(AtomicBool::new(false)));
    let stop = ended.clone();
    let start = Instant::now();
    std::thread::spawn(move || {
        while !stop.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(200));
            let begun = Duration::from_millis(watched.load(Ordering::Relaxed));
            if start.elapsed().saturating_sub(begun) > PATIENCE {
                eprintln!("it takes more than {} s", PATIENCE.as_secs());
                std::process::abort();
            }
        }
    });
    let mut counts = [0u64; 3];
    for number in args.first..args.first + args.inputs {
        since.store(start.elapsed().as_millis() as u64, Ordering::Relaxed);
        note(&place, number, counts);
        let input = seeds.input(name, number);
        counts[2] += u64::from(match name {
            "oct" => fuzz::oct::passes(&input),
            "resume" => fuzz::resume::passes(&input),
            _ => false,
        });
        match (target.run)(&input, folder.path()) {
            Outcome::Taken => counts[0] += 1,
            Outcome::Refused => counts[1] += 1,
        }
        if peak_memory() > MEMORY {
            eprintln!("it takes {} MiB of memory", peak_memory() >> 20);
            std::process::abort();
        }
    }
    note(&place, 0, counts);
    ended.store(true, Ordering::Relaxed);
}

/// Writes down which input is next, and the counts so far.
fn note(place: &std::fs::File, number: u64, counts: [u64; 3]) {
    use std::os::unix::fs::FileExt;
    let record: Vec<u8> = std::iter::once(number).chain(counts).flat_map(u64::to_le_bytes).collect();
    place.write_all_at(&record, 0).unwrap();
}

/// Peak resident memory of this process in bytes, where the system tells.
fn peak_memory() -> u64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let kib = text.lines().find_map(|l| l.strip_prefix("VmHWM:")?.trim().strip_suffix(" kB")?.parse::<u64>().ok());
    kib.unwrap_or(0) << 10
}
