//! One set of rays, one set of answers: however the file was built, whatever walks it, in which order faces and corners stand.
//!
//! The reference is the test of every triangle. Compared are, bit for bit, the closest hit, whether anything is hit, and all hits in
//! order.

#[path = "invariance/bad_rays.rs"]
mod bad_rays;
#[path = "invariance/packets.rs"]
mod packets;
mod trace_common;

use std::cmp::Ordering;

use octrace::build::{BuildOptions, Positions};
use octrace::exact::Line;
use octrace::format::{Flags, PageId, SplitMode};
use octrace::geometry::{FaceId, Hit, Ray, Skip};
use octrace::map::Octree;
use octrace::trace::{Counters, Found, Isa, LinearTracer, OctreeTracer, Order, Tracer, all_hits};
use trace_common::{Mesh, Random, nasty_ray};

const SPLITS: [SplitMode; 3] = [SplitMode::Sah, SplitMode::Octree, SplitMode::Strict];
const ALL: u32 = u32::MAX;

/// Of so many rays one is asked for all its hits.
const LISTED: usize = 4;

type Bits = [u32; 4];

fn bits(hit: Hit) -> Bits {
    [hit.t.to_bits(), hit.face.0, hit.u.to_bits(), hit.v.to_bits()]
}

/// A ray and what it leaves out when its hits are listed.
#[derive(Clone, Copy, Debug)]
struct Query {
    ray: Ray,
    skip: Skip,
}

/// All that is asked about a set of rays.
#[derive(Debug)]
struct Answers {
    closest: Vec<Bits>,
    any: Vec<bool>,
    /// All hits of every [`LISTED`]th ray.
    lists: Vec<Vec<Bits>>,
}

fn list(tracer: &dyn Tracer, query: &Query) -> Vec<Found> {
    all_hits(tracer, &query.ray, query.skip).map(|hit| hit.unwrap()).collect()
}

/// Asks a tracer, in batches and ray by ray.
fn answers(tracer: &dyn Tracer, queries: &[Query]) -> Answers {
    let rays: Vec<Ray> = queries.iter().map(|q| q.ray).collect();
    let (mut hits, mut any) = (vec![Hit::MISS; rays.len()], vec![false; rays.len()]);
    tracer.closest_batch(&rays, &mut hits).unwrap();
    tracer.any_batch(&rays, &mut any).unwrap();
    let lists = queries.iter().step_by(LISTED).map(|q| list(tracer, q).iter().map(|f| bits(f.hit)).collect()).collect();
    Answers { closest: hits.into_iter().map(bits).collect(), any, lists }
}

/// Fails with the ray that was answered otherwise.
fn assert_same(what: &str, queries: &[Query], got: &Answers, expected: &Answers) {
    for (k, query) in queries.iter().enumerate() {
        assert_eq!(got.closest[k], expected.closest[k], "{what}: closest hit of {query:?}");
        assert_eq!(got.any[k], expected.any[k], "{what}: any hit of {query:?}");
        if k % LISTED == 0 {
            assert_eq!(got.lists[k / LISTED], expected.lists[k / LISTED], "{what}: all hits of {query:?}");
        }
    }
}

/// Rays at vertices, edges and faces, from near, far and inside; and along, through and from the corners of octree cells.
fn queries(mesh: &Mesh, octree: &Octree, count: usize, random: &mut Random) -> Vec<Query> {
    let root = octree.root();
    (0..count)
        .map(|k| {
            let ray = if k % 4 == 3 {
                let cells = 1 << random.below(5);
                let corner = |random: &mut Random| -> [f32; 3] {
                    let step = root.side() / f64::from(cells);
                    [root.corner.x, root.corner.y, root.corner.z]
                        .map(|low| (low + step * random.below(cells as usize + 1) as f64) as f32)
                };
                let at = corner(random);
                let direction = match random.below(3) {
                    0 => [0; 3].map(|_| random.pick(&[1.0, -1.0])),
                    1 => [0; 3].map(|_| random.pick(&[1.0, -1.0, 0.0, -0.0])),
                    _ => {
                        let to = corner(random);
                        std::array::from_fn(|i| to[i] - at[i])
                    }
                };
                let back = random.pick(&[0.0, 1.0, 4.0]) * root.side() as f32;
                let ray = Ray::new(std::array::from_fn::<f32, 3, _>(|i| at[i] - back * direction[i]), direction);
                random.pick(&[ray, ray.between(f32::NEG_INFINITY, f32::INFINITY)])
            } else {
                nasty_ray(mesh, random)
            };
            let skip = match random.below(3) {
                0 => Skip::one(FaceId(random.below(mesh.faces.len()) as u32)),
                _ => Skip::NONE,
            };
            Query { ray, skip }
        })
        .collect()
}

/// A mesh, its rays, and what the reference says.
struct Bench {
    name: &'static str,
    mesh: Mesh,
    queries: Vec<Query>,
    expected: Answers,
}

impl Bench {
    fn new(name: &'static str, mesh: Mesh, count: usize, seed: u64) -> Bench {
        let octree = mesh.octree(&BuildOptions::default());
        let queries = queries(&mesh, &octree, count, &mut Random(seed));
        let expected = answers(&LinearTracer::new(&octree).unwrap(), &queries);
        let hits = expected.closest.iter().filter(|hit| hit[1] != FaceId::NONE.0).count();
        assert!(8 * hits > count, "{name}: {hits} hits, the rays test little");
        let several = expected.lists.iter().filter(|l| l.len() > 1).count();
        assert!(20 * several > expected.lists.len(), "{name}: {several} lists of several hits");
        Bench { name, mesh, queries, expected }
    }

    /// Small meshes of all kinds, and one of more than 10^4 triangles.
    fn all() -> Vec<Bench> {
        vec![
            Bench::new("cube on the grid", Mesh::cube(5), 400, 1),
            Bench::new("bumpy sphere", Mesh::sphere(3, 0.2).placed(1.0, 0.3), 400, 2),
            Bench::new("soup", Mesh::soup(200, 3), 400, 3),
            Bench::new("tiny soup", Mesh::soup(100, 4).placed(1e-30, 0.0), 200, 4),
            Bench::new("far sphere", Mesh::sphere(2, 0.1).placed(1.0, 1e5), 200, 5),
            Bench::new("large sphere", Mesh::sphere(6, 0.05), 200, 6),
        ]
    }

    fn is_large(&self) -> bool {
        self.mesh.faces.len() >= 10_000
    }

    fn check(&self, what: &str, tracer: &dyn Tracer) {
        assert_same(&format!("{}, {what}", self.name), &self.queries, &answers(tracer, &self.queries), &self.expected);
    }
}

/// One option at a time through its whole range, in every split mode.
fn files(large: bool) -> Vec<BuildOptions> {
    let mut all = Vec::new();
    for split in SPLITS {
        let base = BuildOptions { split, ..BuildOptions::default() };
        // A strict octree with small cells or bricks splits without end around a vertex and along an edge.
        let strict = split == SplitMode::Strict;
        let deepest = if strict { 5 } else { 21 };
        let leaves = [1, 2, 8, 16].map(|leaf| BuildOptions { leaf, ..base.clone() });
        let cells = [1, 2, 8, 64, ALL].map(|cell| BuildOptions { cell, depth: deepest, ..base.clone() });
        let depths = [0, 1, 2, 3, 6, 12, 21].map(|depth| BuildOptions { depth, ..base.clone() });
        let tiny = match (large, strict) {
            (true, _) => 500,
            (false, true) => 64,
            (false, false) => 1,
        };
        let bricks = [tiny, 7, 64, 1000].map(|n| BuildOptions { brick: Some(n.max(tiny)), ..base.clone() });
        let mixed = [(1, 1, 4, 3), (3, ALL, 0, 50), (2, 4, 4, 200)];
        let mixed = mixed.map(|(leaf, cell, depth, brick): (u8, u32, u8, u32)| BuildOptions {
            leaf,
            cell,
            depth,
            brick: Some(brick.max(tiny)),
            ..base.clone()
        });
        let kinds: [&[BuildOptions]; 5] = [&leaves, &cells, &depths, &bricks, &mixed];
        // Of a large mesh every third file, of each kind another one.
        let step = if large { 3 } else { 1 };
        for (k, kind) in kinds.into_iter().enumerate() {
            all.extend(kind.iter().skip(if large { k % 3 } else { 0 }).step_by(step).cloned());
        }
    }
    all
}

#[test]
fn however_the_file_is_built() {
    for bench in Bench::all() {
        for (k, options) in files(bench.is_large()).into_iter().enumerate() {
            let octree = bench.mesh.octree(&options);
            // Each file with another instruction set and order, so that all meet all.
            let isas = Isa::available();
            let tracer = OctreeTracer::new(&octree).with_isa(isas[k % isas.len()]);
            let tracer = if k / isas.len() % 2 == 1 { tracer.backward() } else { tracer };
            bench.check(&format!("{options:?}"), &tracer);
        }
    }
}

/// Large triangles cut before the mesh is divided into pages, in parts that lie in many of them; and not cut, without ids.
#[test]
fn cut_before_the_partition() {
    let bench = Bench::new("room", Mesh::room(), 400, 7);
    for brick in [20, 100, 1000] {
        for ids in [true, false] {
            let octree = bench.mesh.octree(&BuildOptions { brick: Some(brick), ids, ..BuildOptions::default() });
            let header = octree.header();
            assert!(header.pages > 3000 / brick);
            assert_eq!(header.references > header.triangles + 100, ids, "{brick}: {} references", header.references);
            if !ids {
                continue;
            }
            let mut huge = std::collections::BTreeSet::new();
            let visit = octree.visit();
            for page in (0..header.pages).map(|page| visit.page(PageId(page)).unwrap()) {
                let references = 0..page.header().references;
                // The walls come first in the file.
                huge.extend(
                    references.map(|r| page.face(r).0).filter(|&face| face < 12).map(|face| (face, page.header().page)),
                );
            }
            assert!(huge.len() > 24, "{brick}: walls in {huge:?}");
            for isa in Isa::available() {
                bench.check(&format!("bricks of {brick}, {isa:?}"), &OctreeTracer::new(&octree).with_isa(isa));
            }
            bench.check(&format!("bricks of {brick}, backward"), &OctreeTracer::new(&octree).backward());
        }
    }
}

/// Whether pages are packed, and moved to a grid.
#[test]
fn packed_or_not() {
    for bench in Bench::all() {
        let isas = Isa::available();
        for (k, level) in [1, 3, 19].into_iter().enumerate() {
            for split in SPLITS {
                // Strict bricks hold a triangle many times; of a large mesh they must not be tiny.
                let brick = Some(if bench.is_large() { 2000 } else { 64 });
                let options = BuildOptions { split, brick, compress: Some(level), ..BuildOptions::default() };
                let octree = bench.mesh.octree(&options);
                assert!(octree.header().flags.has(Flags::PACKED), "{}, {options:?}", bench.name);
                let tracer = OctreeTracer::new(&octree)
                    .with_isa(isas[k % isas.len()])
                    .with_order([Order::Single, Order::Flight, Order::Packet][k % 3]);
                bench.check(&format!("{options:?}"), &tracer);
            }
        }
        // Vertices on a grid make another mesh; but that one packed or not is the same.
        let grid = BuildOptions { positions: Positions::Grid(None), brick: Some(2000), ..BuildOptions::default() };
        let plain = bench.mesh.octree(&grid);
        let packed = bench.mesh.octree(&BuildOptions { compress: Some(3), ..grid });
        let expected = answers(&OctreeTracer::new(&plain), &bench.queries);
        let got = answers(&OctreeTracer::new(&packed), &bench.queries);
        assert_same(&format!("{}, on a grid", bench.name), &bench.queries, &got, &expected);
    }
}

#[test]
fn whatever_walks_it() {
    for bench in Bench::all() {
        for split in SPLITS {
            let octree = bench.mesh.octree(&BuildOptions { split, brick: Some(300), ..BuildOptions::default() });
            bench.check("every triangle", &LinearTracer::new(&octree).unwrap());
            for isa in Isa::available() {
                bench.check(&format!("{split:?} {}", isa.name()), &OctreeTracer::new(&octree).with_isa(isa));
                for order in [Order::Single, Order::Flight, Order::Packet] {
                    let tracer = OctreeTracer::new(&octree).with_isa(isa).with_order(order);
                    bench.check(&format!("{split:?} {} {order:?}", isa.name()), &tracer);
                }
                let backward = OctreeTracer::new(&octree).with_isa(isa).backward();
                bench.check(&format!("{split:?} {} far to near", isa.name()), &backward);
            }
        }
    }
}

#[test]
fn far_to_near_takes_another_way() {
    // Else the tests above compare a walk with itself.
    let octree = Mesh::sphere(4, 0.1).octree(&BuildOptions::default());
    let work = |tracer: OctreeTracer<&Octree>| {
        let mut counters = Default::default();
        // From all around; the order of slots is right for most rays, not for each.
        for i in 0..200 {
            let (sin, cos) = (0.1 * i as f32).sin_cos();
            let origin = [5.0 * cos, 5.0 * sin, 0.02 * i as f32 - 2.0];
            tracer.closest_counted(&Ray::new(origin, origin.map(|x| 0.03 - x)), Skip::NONE, &mut counters).unwrap();
        }
        counters.leaves
    };
    let (backward, forward) = (work(OctreeTracer::new(&octree).backward()), work(OctreeTracer::new(&octree)));
    assert!(2 * backward > 3 * forward, "{backward} leaves far to near, {forward} near to far");
}

#[test]
fn whatever_number_of_threads_builds_and_traces() {
    let bench = Bench::new("sphere", Mesh::sphere(5, 0.1), 5000, 7);
    let options = BuildOptions { brick: Some(100), ..BuildOptions::default() };
    for threads in [1, 2, 4] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| bench.check(&format!("{threads} threads"), &OctreeTracer::new(bench.mesh.octree(&options))));
    }
}

#[test]
fn in_whatever_order_the_faces_stand() {
    for bench in Bench::all() {
        let mut random = Random(8);
        let n = bench.mesh.faces.len();
        // Permuted: face k stands where face order[k] stood.
        let mut order: Vec<u32> = (0..n as u32).collect();
        (1..n).rev().for_each(|k| order.swap(k, random.below(k + 1)));
        let mut place = vec![0u32; n];
        order.iter().zip(0..).for_each(|(&from, to)| place[from as usize] = to);
        let mut mesh = bench.mesh.clone();
        mesh.faces = order.iter().map(|&k| bench.mesh.faces[k as usize]).collect();
        let octree = mesh.octree(&BuildOptions::default());
        let tracer = OctreeTracer::new(&octree);
        let original = bench.mesh.octree(&BuildOptions::default());
        let reference = OctreeTracer::new(&original);
        let (mut ties, mut hits) = (0, 0);
        for query in &bench.queries {
            let expected = tied_lists(&query.ray, list(&reference, query));
            let skip = Skip(query.skip.0.map(|f| place.get(f.0 as usize).map_or(FaceId::NONE, |&k| FaceId(k))));
            let got = list(&tracer, &Query { skip, ..*query });
            let mut got = got.iter().map(|f| Hit { face: FaceId(order[f.hit.face.0 as usize]), ..f.hit });
            for mut tied in expected {
                ties += usize::from(tied.len() > 1);
                hits += 1;
                // Among equals the one that stands first.
                tied.sort_by_key(|hit| place[hit.face.0 as usize]);
                let got: Vec<Bits> = got.by_ref().take(tied.len()).map(bits).collect();
                assert_eq!(got, tied.into_iter().map(bits).collect::<Vec<_>>(), "{}, {query:?}", bench.name);
            }
            assert_eq!(got.next(), None, "{}, {query:?}", bench.name);
        }
        assert!(hits > 100 && (ties > 10 || !bench.name.contains("soup")), "{}: {ties} ties, {hits} hits", bench.name);
    }
}

/// A list of hits cut into groups of exactly equal t.
fn tied_lists(ray: &Ray, list: Vec<Found>) -> Vec<Vec<Hit>> {
    let mut groups: Vec<Vec<Hit>> = Vec::new();
    let mut last = None;
    if list.is_empty() {
        return groups;
    }
    let line = Line::new(ray);
    for found in list {
        let crossing = line.meet(&found.triangle).crossing.unwrap();
        let equal = last.replace(crossing).is_some_and(|before| crossing.cmp(&before, &line) == Ordering::Equal);
        match groups.last_mut() {
            Some(group) if equal => group.push(found.hit),
            _ => groups.push(vec![found.hit]),
        }
    }
    groups
}

#[test]
fn in_whatever_order_the_corners_of_a_face_stand() {
    for bench in Bench::all() {
        // Corner k of the turned mesh is corner TURNS[..][k] of the original.
        let [left, right, flipped] = [[1, 2, 0], [2, 0, 1], [0, 2, 1]].map(|turn: [usize; 3]| {
            let mut mesh = bench.mesh.clone();
            mesh.faces.iter_mut().for_each(|f| *f = turn.map(|k| f[k]));
            answers(&OctreeTracer::new(mesh.octree(&BuildOptions::default())), &bench.queries)
        });
        let same = |k: usize, [hit, left, right, flipped]: [Bits; 4]| {
            let query = &bench.queries[k];
            for other in [left, right, flipped] {
                assert_eq!(other[..2], hit[..2], "{}, {query:?}", bench.name);
            }
            if hit[1] == FaceId::NONE.0 {
                return;
            }
            let [u, v] = [hit[2], hit[3]];
            // Each weight is rounded correctly, so it is the same wherever its corner stands; w has no place but in turned faces.
            assert_eq!((left[2], right[3], left[3]), (v, u, right[2]), "{}, {query:?}", bench.name);
            assert_eq!([flipped[2], flipped[3]], [v, u], "{}, {query:?}", bench.name);
            let w = 1.0 - f64::from(f32::from_bits(u)) - f64::from(f32::from_bits(v));
            assert!((w - f64::from(f32::from_bits(left[3]))).abs() < 1.5 / 16_777_216.0, "{}, {query:?}", bench.name);
        };
        for k in 0..bench.queries.len() {
            same(k, [&bench.expected, &left, &right, &flipped].map(|a| a.closest[k]));
            assert!([&left, &right, &flipped].iter().all(|a| a.any[k] == bench.expected.any[k]));
        }
        for k in 0..bench.expected.lists.len() {
            let lists = [&bench.expected, &left, &right, &flipped].map(|a| &a.lists[k]);
            assert!(lists.iter().all(|l| l.len() == lists[0].len()), "{}", bench.name);
            (0..lists[0].len()).for_each(|i| same(k * LISTED, lists.map(|l| l[i])));
        }
    }
}
