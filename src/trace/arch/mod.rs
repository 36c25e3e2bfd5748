//! The inner loops of the walk, one implementation an instruction set.
//!
//! A [`Kernel`] does three things: which slots of a node a ray touches, the frame of a child, and the f32 filter over a leaf.
//! [`scalar`] is portable, safe Rust and defines the results: another kernel must give a leaf the same masks, bit for bit (the
//! filter's operations are the same IEEE operations in the same order, never fused), and a node any mask that holds every
//! slot which the exact ray touches. The answers of a query depend on neither, since the exact test decides: so all kernels agree.
//!
//! The walk is generic over its kernel and inlined whole into a function that enables the instruction set ([`Job`], [`Isa::run`]), so
//! that no call stands between its steps. What the processor can do is found out once.
#![allow(unsafe_code)]

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod scalar;

use std::sync::OnceLock;

use crate::exact::{Lanes, Shear};
use crate::format::{Leaf, Node};

/// The parameters of a node's frame, axes x, y, z and one unused lane: with the slack of the setup taken off and added, plane
/// q is entered at `begin + q * dt` at the earliest and left at `end + q * dt` at the latest.
#[derive(Clone, Copy, Debug, bytemuck::Zeroable)]
#[repr(C, align(16))]
pub(super) struct Planes {
    pub begin: [f32; 4],
    pub end: [f32; 4],
    pub dt: [f32; 4],
}

/// The part of a prepared ray that the node test needs.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(16))]
pub(super) struct Way {
    /// 2^-32 in parameter units: dt of the smallest frame.
    pub least: [f32; 4],
    /// The direction mask a: bit 2 - i set where axis i is traversed downwards.
    pub mask: u8,
    /// Slots are visited as i XOR this: a for near to far, its complement for far to near.
    pub order: u8,
    /// The parameter at which the ray enters the root.
    pub near: f32,
}

/// The slots of a node that the ray touches, in the order of visits: entry i stands for slot i XOR `order` of the [`Way`].
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(super) struct Touched {
    /// Lower bound of the parameter at which each slot is entered.
    pub near: [f32; 8],
    /// A bit an entry; no others.
    pub slots: u32,
}

/// The inner loops for one instruction set. A value of the type is proof that the processor has it.
pub(super) trait Kernel: Copy {
    /// Which slots the ray touches between `way.near` and `far`. Empty slots are left to the caller.
    fn touch(self, node: &Node, planes: &Planes, way: &Way, far: f32) -> Touched;
    /// A bit for each of the entries `near` that is not beyond `far`.
    fn within(self, near: &[f32; 8], far: f32) -> u32;
    /// The parameters of the frame of the inner child in `slot` (0..8); FORMAT.md, "Frame".
    fn child(self, planes: &Planes, node: &Node, slot: usize, way: &Way) -> Planes;
    /// The filter's word on each triangle of a leaf.
    fn classify(self, leaf: &Leaf<'_>, shear: &Shear) -> Lanes;
}

/// Something to be done with whichever kernel is there.
pub(super) trait Job {
    /// What it gives.
    type Output;
    /// Does it. To be `#[inline(always)]`, with all that it calls in its hot loop.
    fn run<K: Kernel>(self, kernel: K) -> Self::Output;
}

/// An instruction set that this processor has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Isa(Set);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Set {
    Scalar,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Isa {
    /// Portable code; always there.
    pub const SCALAR: Isa = Isa(Set::Scalar);

    /// The best that this processor has; found out once.
    pub fn best() -> Isa {
        static BEST: OnceLock<Isa> = OnceLock::new();
        *BEST.get_or_init(|| *Isa::available().last().unwrap_or(&Isa::SCALAR))
    }

    /// All that this processor has, the best last.
    pub fn available() -> Vec<Isa> {
        let mut found = vec![Isa::SCALAR];
        #[cfg(target_arch = "x86_64")]
        {
            if avx2::Avx2::detect().is_some() {
                found.push(Isa(Set::Avx2));
            }
            if avx512::Avx512::detect().is_some() {
                found.push(Isa(Set::Avx512));
            }
        }
        found
    }

    /// By its name: `scalar`, `avx2` or `avx512`; `None` if this processor has no such set.
    pub fn named(name: &str) -> Option<Isa> {
        Isa::available().into_iter().find(|isa| isa.name() == name)
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self.0 {
            Set::Scalar => "scalar",
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Set::Avx512 => "avx512",
        }
    }

    /// Does a job with this set's kernel.
    #[inline]
    pub(super) fn run<J: Job>(self, job: J) -> J::Output {
        match self.0 {
            Set::Scalar => job.run(scalar::Scalar),
            // SAFETY: an `Isa` other than scalar is only made where the processor was found to have it.
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 => unsafe { avx2::run(job) },
            // SAFETY: as above.
            #[cfg(target_arch = "x86_64")]
            Set::Avx512 => unsafe { avx512::run(job) },
        }
    }
}

#[cfg(test)]
mod tests;
