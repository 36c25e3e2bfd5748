//! Progress of a phase that goes over the same triangles several times: each time is a step, all of the same share.

use crate::error::Result;
use crate::event::Monitor;

/// How far the steps are.
pub(super) struct Steps<'m> {
    monitor: Monitor<'m>,
    triangles: u64,
    steps: u64,
    done: u64,
}

impl<'m> Steps<'m> {
    /// So many steps over so many triangles.
    pub fn new(monitor: Monitor<'m>, triangles: u64, steps: u64) -> Steps<'m> {
        Steps { monitor, triangles, steps, done: 0 }
    }

    /// Says that `part` of `whole` of the current step is done. Fails if the work is to stop.
    pub fn at(&self, part: u64, whole: u64) -> Result<()> {
        self.monitor.check()?;
        let share = part.min(whole) as f64 / whole.max(1) as f64;
        let done = (self.done as f64 + share) / self.steps as f64 * self.triangles as f64;
        self.monitor.progress(done as u64, Some(self.triangles), "triangles");
        Ok(())
    }

    /// Ends a step.
    pub fn next(&mut self) {
        self.done += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::event::Event;
    use std::sync::Mutex;
    use std::sync::atomic::{AtomicBool, Ordering};

    #[test]
    fn steps_share_the_phase() {
        let (told, stop) = (Mutex::new(Vec::new()), AtomicBool::new(false));
        let sink = |event: Event| {
            if let Event::Progress { done, .. } = event {
                told.lock().unwrap().push(done);
            }
        };
        let mut steps = Steps::new(Monitor::new(&sink, &stop), 900, 3);
        for _ in 0..3 {
            steps.at(1, 2).unwrap();
            steps.at(7, 7).unwrap();
            steps.next();
        }
        stop.store(true, Ordering::Relaxed);
        assert!(steps.at(0, 0).is_err());
        assert_eq!(told.into_inner().unwrap(), [150, 300, 450, 600, 750, 900]);
    }
}
