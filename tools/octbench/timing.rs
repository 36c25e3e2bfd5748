//! Clocks, and the means of what they tell.

use std::time::Instant;

use octrace::Result;
use serde::Serialize;

use crate::cli::stats::cpu_seconds;

/// What is read before and after a round.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Clock {
    /// The time that passed
    Wall,
    /// The processor's time, for one thread on a machine that others work on
    Cpu,
}

impl Clock {
    /// Does some work; the seconds it took, and what came of it.
    pub fn time<T>(self, work: impl FnOnce() -> Result<T>) -> Result<(f64, T)> {
        let (started, used) = (Instant::now(), cpu_seconds());
        let result = work()?;
        let seconds = match self {
            Clock::Wall => started.elapsed().as_secs_f64(),
            Clock::Cpu => cpu_seconds() - used,
        };
        Ok((seconds, result))
    }

    /// What tables say of it.
    pub fn note(self) -> &'static str {
        match self {
            Clock::Wall => "",
            Clock::Cpu => ", processor time",
        }
    }
}

/// Million rays a second, by the median of the seconds that rounds took.
pub fn mrays(rays: u64, seconds: &[f64]) -> f64 {
    rays as f64 * 1e-6 / median(seconds.to_vec()).max(1e-12)
}

/// The median; of an even number of values the mean of the middle two; 0 of none.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => 0.0,
        n if n % 2 == 1 => values[n / 2],
        n => 0.5 * (values[n / 2 - 1] + values[n / 2]),
    }
}

/// How many times as fast `a` was as `b`, from the seconds of rounds: the median of what each round gave.
pub fn ratio(a: &[f64], b: &[f64]) -> f64 {
    median(a.iter().zip(b).map(|(a, b)| b / a).collect())
}

/// The geometric mean of positive numbers; 1 of none.
pub fn geometric_mean(values: &[f64]) -> f64 {
    (values.iter().map(|x| x.ln()).sum::<f64>() / values.len().max(1) as f64).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_ratios_and_means() {
        assert_eq!(median(vec![]), 0.0);
        assert_eq!(median(vec![3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(vec![4.0, 1.0, 2.0, 3.0]), 2.5);
        // Rounds are compared in pairs: a round in which the machine was slow for both counts like the others.
        assert_eq!(ratio(&[1.0, 10.0, 2.0], &[2.0, 20.0, 4.0]), 2.0);
        assert!((geometric_mean(&[0.5, 2.0, 8.0]) - 2.0).abs() < 1e-12);
        assert_eq!(mrays(3_000_000, &[2.0, 1.0, 9.0]), 1.5);
    }

    #[test]
    fn clocks_tell_what_work_took() {
        let spin = || {
            let started = Instant::now();
            while started.elapsed().as_millis() < 20 {}
            Ok(7)
        };
        let (seconds, result) = Clock::Wall.time(spin).unwrap();
        assert!(seconds >= 0.02 && result == 7);
        let sleep = || {
            std::thread::sleep(std::time::Duration::from_millis(300));
            Ok(())
        };
        assert!(Clock::Wall.time(sleep).unwrap().0 >= 0.3);
    }
}
