//! The kernels that can be measured: a list, to which a new one is added as one entry.

use octrace::Result;
use octrace::geometry::{Hit, Ray};
use octrace::map::Octree;
use octrace::trace::{Counters, OctreeTracer, Order, Tracer};

/// The tracer as it is measured.
pub type Measured<'a> = OctreeTracer<&'a Octree>;
/// Answers rays: one answer a ray.
pub type Batch<A> = fn(&Measured<'_>, &[Ray], &mut [A]) -> Result<Counters>;

/// One way to answer many rays.
pub struct Kernel {
    /// Name in tables and on the command line.
    pub name: &'static str,
    /// For a kernel that rounds: the exact one that does the same work otherwise. What exactness costs is told from such pairs.
    pub float_of: Option<&'static str>,
    /// Closest hits, if it can.
    pub closest: Option<Batch<Hit>>,
    /// Whether anything is hit, if it can.
    pub any: Option<Batch<bool>>,
}

/// All kernels.
pub const KERNELS: &[Kernel] = &[
    Kernel {
        name: "single",
        float_of: None,
        closest: Some(|tracer, rays, hits| tracer.clone().with_order(Order::Single).closest_batch(rays, hits)),
        any: Some(|tracer, rays, blocked| tracer.clone().with_order(Order::Single).any_batch(rays, blocked)),
    },
    Kernel {
        name: "flight",
        float_of: None,
        closest: Some(|tracer, rays, hits| tracer.clone().with_order(Order::Flight).closest_batch(rays, hits)),
        any: Some(|tracer, rays, blocked| tracer.clone().with_order(Order::Flight).any_batch(rays, blocked)),
    },
    Kernel {
        name: "packet",
        float_of: None,
        closest: Some(|tracer, rays, hits| tracer.clone().with_order(Order::Packet).closest_batch(rays, hits)),
        any: Some(|tracer, rays, blocked| tracer.clone().with_order(Order::Packet).any_batch(rays, blocked)),
    },
    Kernel {
        name: "float",
        float_of: Some("single"),
        closest: Some(|tracer, rays, hits| tracer.rough_closest_batch(rays, hits, false)),
        any: Some(|tracer, rays, blocked| tracer.rough_any_batch(rays, blocked, false)),
    },
    Kernel {
        name: "float-packet",
        float_of: Some("packet"),
        closest: Some(|tracer, rays, hits| tracer.rough_closest_batch(rays, hits, true)),
        any: Some(|tracer, rays, blocked| tracer.rough_any_batch(rays, blocked, true)),
    },
];

/// The kernel of a name.
pub fn named(name: &str) -> std::result::Result<&'static Kernel, String> {
    KERNELS.iter().find(|k| k.name == name).ok_or_else(|| {
        let names: Vec<_> = KERNELS.iter().map(|k| k.name).collect();
        format!("the kernels are {}", names.join(", "))
    })
}
