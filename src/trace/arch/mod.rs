//! The inner loops of the walk, one implementation an instruction set.
//!
//! A [`Kernel`] aims rays, tells which slots of a node a ray touches, finds the frame of a child, filters a leaf's triangles in f32 and rounds t, u
//! and v in f64; as a [`Wide`] it calculates with sixteen numbers at once.
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
#[cfg(target_arch = "x86_64")]
mod round;
mod scalar;
mod wide;

use std::sync::OnceLock;

pub(super) use wide::{Row, WIDE, Wide, greatest};

use crate::exact::{Depths, Lanes, Shear};
use crate::format::{Leaf, Node};
use crate::geometry::Ray;

/// A frame's place in root units; axes x, y, z.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    pub corner: [f32; 3],
    pub unit: [f32; 3],
}

/// What all rays of a file share when they are aimed; `setup.rs` explains.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(super) struct Fit {
    /// The root's corner.
    pub corner: [f64; 4],
    /// 1 / the root's side.
    pub scale: f64,
    /// The root's side, if it is moderate; else infinite.
    pub side: f32,
    /// eps (L + 8).
    pub rounding: f32,
}

/// What turns planes into parameters; `setup.rs` explains. The fourth lanes hold anything.
#[derive(Clone, Copy, Debug, Default, bytemuck::Zeroable)]
#[repr(C, align(32))]
pub(super) struct Aim {
    /// p'.
    pub origin: [f64; 4],
    /// 1 / g, or side / d.
    pub inv: [f32; 4],
    /// In parameter units.
    pub slack: [f32; 4],
}

/// The parameters of a node's frame, axes x, y, z and one unused lane: with the slack of the setup taken off, plane q is
/// entered at `begin + q * dt` at the earliest; it is left at that plus [`Way::slack`] at the latest.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(16))]
pub(super) struct Planes {
    pub begin: [f32; 4],
    pub dt: [f32; 4],
}

/// The part of a prepared ray that the node test needs.
#[derive(Clone, Copy, Debug, Default, bytemuck::Zeroable)]
#[repr(C, align(16))]
pub(super) struct Way {
    /// 2^-32 in parameter units: dt of the smallest frame. Twice, then negated twice.
    pub least: [[f32; 4]; 4],
    /// Twice the setup's slack.
    pub slack: [f32; 4],
    /// The direction mask a: bit 2 - i set where axis i is traversed downwards.
    pub mask: u8,
    /// Slots are visited as i XOR this: a for near to far, its complement for far to near.
    pub order: u8,
    /// Both in one number: a, plus 8 for far to near.
    pub row: u8,
    /// The parameter at which the ray begins.
    pub near: f32,
}

impl Way {
    /// Sets the order of visits: `turn` is 0 for near to far, 7 for far to near.
    #[inline(always)]
    pub fn visit(&mut self, turn: u8) {
        self.order = self.mask ^ turn;
        self.row = self.mask & 7 | (turn & 1) << 3;
    }
}

/// How far a plain ray's origin may be from the root, in root sizes.
pub(super) const NEAR: f64 = 16.0;

/// The magnitudes that the components of a plain ray's direction may have.
pub(super) const MODERATE: [f32; 2] = [1.0 / (1u64 << 40) as f32, (1u64 << 40) as f32];

/// A node under way, put aside. Entry i of `near` is a lower bound of the parameter at which slot i XOR a is entered.
#[derive(Clone, Copy, Debug, bytemuck::Zeroable)]
#[repr(C, align(32))]
pub(super) struct Saved {
    /// As the kernel has it. First, so that it lies in one cache line where this begins with one.
    frame: [f32; 16],
    near: [f32; 8],
}

/// Hits whose t, u and v are wanted: triangles, and the rays that are known to hit them; entry i of each axis belongs to hit i.
#[derive(Clone, Copy, Debug, bytemuck::Zeroable)]
#[repr(C, align(64))]
pub(super) struct Block {
    pub a: [Row; 3],
    pub b: [Row; 3],
    pub c: [Row; 3],
    pub origin: [Row; 3],
    pub direction: [Row; 3],
}

/// The t, u and v of a block's hits; those whose bit is set in `certain` are correctly rounded, others hold anything.
#[derive(Clone, Copy, Debug, bytemuck::Zeroable)]
#[repr(C, align(64))]
pub(super) struct Rounded {
    pub t: Row,
    pub u: Row,
    pub v: Row,
    pub certain: u32,
}

/// The inner loops for one instruction set. A value of the type is proof that the processor has it.
pub(super) trait Kernel: Wide {
    /// [`Planes`] in registers.
    type Frame: Copy;
    /// Eight lower bounds, in the order of visits: entry i stands for slot i XOR a.
    type Near: Copy;
    /// The parameters between which a ray counts.
    type Ends: Copy;

    /// Aims a plain ray: sets all of `aim`, and of `way` what belongs to a direction. False, and nothing of use set, if the ray
    /// is not plain or hits nothing whatever.
    fn aim(self, ray: &Ray, fit: &Fit, way: &mut Way, aim: &mut Aim) -> bool;
    /// The parameters of the root's or a brick's own frame.
    fn frame(self, cell: &Cell, aim: &Aim, way: &Way) -> Self::Frame;
    /// Puts a node aside.
    fn save(self, saved: &mut Saved, frame: Self::Frame, near: Self::Near);
    /// Takes a node up again.
    fn load(self, saved: &Saved) -> (Self::Frame, Self::Near);
    /// Asks for the cache line so many bytes behind the start of something, ahead of its use.
    fn fetch<T>(self, from: &T, bytes: usize);
    /// The parameters `near` and `far`.
    fn ends(self, near: f32, far: f32) -> Self::Ends;
    /// Which slots the ray touches between its ends, a bit an entry in the order of visits, and where they are
    /// entered. Empty slots are left to the caller.
    fn touch(self, node: &Node, frame: Self::Frame, way: &Way, ends: Self::Ends) -> (u32, Self::Near);
    /// For each axis the planes by which slots are entered, in the order of visits, and behind these eight those by which they are
    /// left, in units of the node's frame.
    fn planes(self, node: &Node, way: &Way) -> [Self::Floats; 3];
    /// A bit for each of the entries that is not beyond `far`.
    fn within(self, near: Self::Near, far: f32) -> u32;
    /// The frame of the inner child in `slot` (0..8); FORMAT.md, "Frame".
    fn child(self, frame: Self::Frame, node: &Node, slot: usize, way: &Way) -> Self::Frame;
    /// The filter's word on each triangle of a leaf; as [`Shear::classify`].
    fn classify(self, leaf: &Leaf<'_>, shear: &Shear, range: [f32; 2], depths: &mut Depths) -> Lanes;
    /// t, u, v of those hits of a block whose bit is set in `wanted`, each as [`Line::rounded`](crate::exact::Line::rounded).
    fn rounded(self, block: &Block, wanted: u32, to: &mut Rounded);
    /// The nearest triangle of a leaf that the ray seems to hit at a t in the closed `range`, in f32 without any bound of the error.
    /// No tracer answers with it: it measures what exactness costs.
    fn nearest(self, leaf: &Leaf<'_>, shear: &Shear, range: [f32; 2]) -> Option<Rough>;
}

/// A hit as f32 has it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rough {
    /// The triangle's number in its leaf.
    pub lane: u32,
    pub t: f32,
    /// Weight of the second corner.
    pub u: f32,
    /// Weight of the third corner.
    pub v: f32,
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

    /// Names of all that were compiled in, whatever the processor has, the best last.
    pub const COMPILED: &[&str] =
        if cfg!(target_arch = "x86_64") { &["scalar", "avx2", "avx512"] } else { &["scalar"] };

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
