//! build
pub(crate) mod subtree;
