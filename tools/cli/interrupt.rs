//! Ctrl-C (and SIGTERM, SIGHUP): the first asks the work to stop, the second ends the program at once.

use std::sync::atomic::{AtomicBool, Ordering};

use octrace::{Error, Kind};

static STOP: AtomicBool = AtomicBool::new(false);

/// True once the user asked to stop.
pub fn flag() -> &'static AtomicBool {
    &STOP
}

/// Begins to listen; called once.
pub fn listen() -> Result<(), Error> {
    ctrlc::set_handler(|| {
        if STOP.swap(true, Ordering::Relaxed) {
            std::process::exit(Kind::Interrupted.exit_code().into());
        }
    })
    .map_err(|e| Error::Option(format!("cannot listen for Ctrl-C: {e}")))
}
