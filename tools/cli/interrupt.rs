//! Signals. Ctrl-C (and SIGTERM, SIGHUP): the first asks the work to stop, the second ends the program at once.

#[cfg(unix)]
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use octrace::{Error, Kind};

static STOP: AtomicBool = AtomicBool::new(false);

/// True once the user asked to stop.
pub fn flag() -> &'static AtomicBool {
    &STOP
}

/// Begins to listen; called once.
pub fn listen() -> Result<(), Error> {
    survive_file_limits()?;
    ctrlc::set_handler(|| {
        if STOP.swap(true, Ordering::Relaxed) {
            std::process::exit(Kind::Interrupted.exit_code().into());
        }
    })
    .map_err(|e| Error::Option(format!("cannot listen for Ctrl-C: {e}")))
}

/// A write beyond the limit on file sizes (`ulimit -f`) is then an error like a full disk, and does not end the process at once.
fn survive_file_limits() -> Result<(), Error> {
    #[cfg(unix)]
    signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::new(AtomicBool::new(false)))
        .map_err(|e| Error::Option(format!("cannot listen for SIGXFSZ: {e}")))?;
    Ok(())
}
