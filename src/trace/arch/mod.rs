//! The inner loops of the walk, one implementation an instruction set.
//!
//! [`scalar`] is portable, safe Rust over fixed arrays, which compilers turn into vector code for the machine they build
//! for. It defines the results: another implementation beside it must give the same masks for leaves, and for nodes any mask that
//! holds every slot which the exact ray touches.

pub(super) mod scalar;

/// The parameters of a node's frame: plane q of axis i lies at `t0[i] + q * dt[i]`, within the slack of the setup.
#[derive(Clone, Copy, Debug)]
pub(super) struct Planes {
    pub t0: [f32; 3],
    pub dt: [f32; 3],
}

/// The slots of a node that the ray touches.
#[derive(Clone, Copy, Debug)]
pub(super) struct Touched {
    /// Lower bound of the parameter at which each slot is entered.
    pub near: [f32; 8],
    /// A bit a slot.
    pub slots: u8,
}
