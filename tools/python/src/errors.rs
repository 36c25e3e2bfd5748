//! Errors of the library as exceptions; the classes are in `python/octrace/errors.py`.

use octrace::{Error, Kind};
use pyo3::PyErr;
use pyo3::exceptions::PyKeyboardInterrupt;

mod classes {
    pyo3::import_exception!(octrace.errors, DamagedError);
    pyo3::import_exception!(octrace.errors, InputError);
    pyo3::import_exception!(octrace.errors, MachineError);
    pyo3::import_exception!(octrace.errors, MissingError);
}

/// The exception for an error, with the library's message.
pub fn raise(error: Error) -> PyErr {
    let text = error.to_string();
    match (error.kind(), &error) {
        (Kind::Input, Error::Io { .. }) => classes::MissingError::new_err(text),
        (Kind::Input, _) => classes::InputError::new_err(text),
        (Kind::Damaged, _) => classes::DamagedError::new_err(text),
        (Kind::Machine, _) => classes::MachineError::new_err(text),
        (Kind::Interrupted, _) => PyKeyboardInterrupt::new_err(text),
    }
}

/// The exception for an argument that is wrong.
pub fn wrong(what: impl Into<String>) -> PyErr {
    classes::InputError::new_err(what.into())
}
