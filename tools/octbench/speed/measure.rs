//! Rounds: everything that is compared traces the same rays in turn, so that what slows the machine slows all alike.

use std::path::Path;

use octrace::geometry::Hit;
use octrace::map::Octree;
use octrace::trace::{Counters, Isa, OctreeTracer};
use octrace::{Error, Monitor, Result};
use rayon::ThreadPool;

use super::kernels::{Kernel, Measured};
use super::peer::Peer;
use super::sets::{Question, RaySet};
use crate::timing::Clock;

/// How to measure.
pub struct Rounds<'a> {
    /// Rounds that are timed.
    pub count: u32,
    /// Numbers of threads that peers are asked to use.
    pub threads: &'a [usize],
    /// What is read.
    pub clock: Clock,
    /// Tells when to stop.
    pub monitor: Monitor<'a>,
}

/// One of our own ways to trace: a kernel, an instruction set, a number of threads.
pub struct Own<'a> {
    /// The kernel.
    pub kernel: &'static Kernel,
    /// The tracer, which knows the instruction set.
    pub tracer: Measured<'a>,
    /// Threads.
    pub pool: &'a ThreadPool,
}

impl<'a> Own<'a> {
    /// A way to trace a file.
    pub fn new(octree: &'a Octree, kernel: &'static Kernel, isa: Isa, pool: &'a ThreadPool) -> Own<'a> {
        Own { kernel, tracer: OctreeTracer::new(octree).with_isa(isa), pool }
    }

    /// Whether it can answer such a question.
    pub fn can(&self, question: Question) -> bool {
        match question {
            Question::Closest => self.kernel.closest.is_some(),
            Question::Any => self.kernel.any.is_some(),
        }
    }

    /// Traces all rays once; the seconds that took, and the work.
    fn round(&self, set: &RaySet, clock: Clock, answers: &mut Answers) -> Result<(f64, Counters)> {
        let Own { kernel, tracer, pool } = self;
        pool.install(|| {
            clock.time(|| match (answers, kernel.closest, kernel.any) {
                (Answers::Hits(hits), Some(closest), _) => closest(tracer, &set.rays, hits),
                (Answers::Blocked(blocked), _, Some(any)) => any(tracer, &set.rays, blocked),
                _ => unreachable!("only kernels that can answer are asked"),
            })
        })
    }
}

/// Answers of a set.
#[derive(Clone, PartialEq)]
enum Answers {
    Hits(Vec<Hit>),
    Blocked(Vec<bool>),
}

impl Answers {
    fn room(set: &RaySet) -> Answers {
        match set.question {
            Question::Closest => Answers::Hits(vec![Hit::MISS; set.rays.len()]),
            Question::Any => Answers::Blocked(vec![false; set.rays.len()]),
        }
    }

    fn hits(&self) -> u64 {
        match self {
            Answers::Hits(list) => list.iter().filter(|h| h.is_hit()).count() as u64,
            Answers::Blocked(list) => list.iter().filter(|b| **b).count() as u64,
        }
    }
}

/// How one contender did on one set.
#[derive(Clone, Debug, Default)]
pub struct Times {
    /// Seconds of each round.
    pub seconds: Vec<f64>,
    /// Rays that hit something.
    pub hits: u64,
    /// Work done in one round; nothing is known of peers.
    pub work: Counters,
}

/// What a set gave: times of our own ways that can answer (with their numbers), times of peers by thread count.
pub struct Outcome {
    /// Number of the way, and its times.
    pub own: Vec<(usize, Times)>,
    /// Peer number, threads, and its times.
    pub peers: Vec<(usize, usize, Times)>,
    /// Exact ways whose answers are not those of the first, bit for bit: their numbers.
    pub differing: Vec<usize>,
}

/// Measures one set: a round of each that is not timed, then rounds in turn.
pub fn measure(
    set: &RaySet,
    file: Option<&Path>,
    ways: &[Own<'_>],
    peers: &mut [Peer],
    rounds: &Rounds<'_>,
) -> Result<Outcome> {
    let Rounds { clock, monitor, .. } = *rounds;
    let mut answers = Answers::room(set);
    let mut first: Option<Answers> = None;
    let mut out = Outcome { own: vec![], peers: vec![], differing: vec![] };
    for (number, way) in ways.iter().enumerate().filter(|(_, way)| way.can(set.question)) {
        let (_, work) = way.round(set, clock, &mut answers)?;
        out.own.push((number, Times { seconds: vec![], hits: answers.hits(), work }));
        if way.kernel.float_of.is_none() && first.get_or_insert_with(|| answers.clone()) != &answers {
            out.differing.push(number);
        }
        monitor.check()?;
    }
    drop(first);
    let rays = || file.ok_or_else(|| Error::Option("a peer needs a file of rays".to_owned()));
    for (number, peer) in peers.iter_mut().enumerate() {
        for &n in rounds.threads {
            let hits = peer.round(set.question, n, rays()?)?.hits;
            out.peers.push((number, n, Times { hits, ..Times::default() }));
        }
    }
    for _ in 0..rounds.count {
        for (number, times) in &mut out.own {
            times.seconds.push(ways[*number].round(set, clock, &mut answers)?.0);
            monitor.check()?;
        }
        for (number, n, times) in &mut out.peers {
            times.seconds.push(peers[*number].round(set.question, *n, rays()?)?.seconds(clock)?);
            monitor.check()?;
        }
    }
    Ok(out)
}
