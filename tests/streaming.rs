//! Files read within a budget of memory: every answer as from a mapped one, bit for bit, whatever the budget.

mod trace_common;

use std::path::Path;

use octrace::build::{BuildOptions, build};
use octrace::event::Monitor;
use octrace::geometry::{Aabb, FaceId, Hit, Ray, Skip};
use octrace::map::{Octree, Read};
use octrace::trace::{Found, Isa, LinearTracer, OctreeTracer, Order, Tracer, all_hits, triangles_in_box};
use trace_common::{Mesh, Random, nasty_ray};

/// Builds a file of many small pages at `path`.
fn write(mesh: &Mesh, path: &Path, brick: u32, compress: Option<i32>) {
    let options = BuildOptions { brick: Some(brick), compress, ..BuildOptions::default() };
    build(&mut mesh.source(), path, &options, Monitor::silent()).unwrap();
}

fn budgeted(path: &Path, cache: u64) -> Octree {
    Octree::open_with(path, Read::Budgeted { cache }).unwrap()
}

fn bits(hit: Hit) -> [u32; 4] {
    [hit.t.to_bits(), hit.face.0, hit.u.to_bits(), hit.v.to_bits()]
}

fn hit(found: Option<Found>) -> Hit {
    found.map_or(Hit::MISS, |found| found.hit)
}

/// Nasty rays, and a bundle of neighbours from one point.
fn rays(mesh: &Mesh, count: usize, seed: u64) -> Vec<Ray> {
    let mut random = Random(seed);
    let mut rays: Vec<Ray> = (0..count).map(|_| nasty_ray(mesh, &mut random)).collect();
    for i in 0..32 * 64 {
        let (x, y) = ((i % 64) as f32 / 32.0 - 1.0, (i / 64) as f32 / 16.0 - 1.0);
        rays.push(Ray::new([0.3, 0.2, 4.0], [x * 0.4, y * 0.4, -1.0]));
    }
    rays
}

/// Every kind of question to one file, against a reference.
fn compare(name: &str, reference: &Octree, octree: &Octree, rays: &[Ray]) {
    let skips: Vec<Skip> =
        (0..rays.len()).map(|i| if i % 3 == 0 { Skip::one(FaceId(i as u32 % 50)) } else { Skip::NONE }).collect();
    let expected = Answers::of(&OctreeTracer::new(reference), rays, &skips);
    for order in [None, Some(Order::Single), Some(Order::Flight), Some(Order::Packet)] {
        let tracer = OctreeTracer::new(octree);
        let tracer = match order {
            Some(order) => tracer.with_order(order),
            None => tracer.with_isa(Isa::named("scalar").unwrap()),
        };
        let answers = Answers::of(&tracer, rays, &skips);
        for (i, ray) in rays.iter().enumerate() {
            assert_eq!(bits(answers.hits[i]), bits(expected.hits[i]), "{name}, {order:?}, closest of {ray:?}");
            assert_eq!(bits(answers.each[i]), bits(expected.each[i]), "{name}, {order:?}, closest but one of {ray:?}");
            assert_eq!(answers.blocked[i], expected.blocked[i], "{name}, {order:?}, any of {ray:?}");
            assert_eq!(answers.skipped[i], expected.skipped[i], "{name}, {order:?}, any but one of {ray:?}");
            assert_eq!(answers.short[i], expected.skipped[i], "{name}, {order:?}, any of {ray:?} as if it were short");
        }
    }
}

struct Answers {
    hits: Vec<Hit>,
    each: Vec<Hit>,
    blocked: Vec<bool>,
    skipped: Vec<bool>,
    short: Vec<bool>,
}

impl Answers {
    fn of(tracer: &OctreeTracer<&Octree>, rays: &[Ray], skips: &[Skip]) -> Answers {
        let n = rays.len();
        let mut answers = Answers {
            hits: vec![Hit::MISS; n],
            each: Vec::new(),
            blocked: vec![false; n],
            skipped: vec![false; n],
            short: vec![false; n],
        };
        let (mut found, counters) = (vec![None; n], &mut Default::default());
        let counted = tracer.closest_batch(rays, &mut answers.hits).unwrap();
        assert_eq!(counted.rays, n as u64);
        tracer.any_batch(rays, &mut answers.blocked).unwrap();
        tracer.closest_each(rays, skips, &mut found, counters).unwrap();
        answers.each = found.into_iter().map(hit).collect();
        tracer.any_each(rays, skips, &mut answers.skipped, counters).unwrap();
        tracer.any_short(rays, skips, &mut answers.short, counters).unwrap();
        assert_eq!(counters.rays, 3 * n as u64);
        answers
    }
}

#[test]
fn any_budget_and_packing_gives_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    for (name, mesh, brick) in
        [("sphere", Mesh::sphere(6, 0.01), 300), ("room", Mesh::room(), 300), ("soup", Mesh::soup(900, 3), 100)]
    {
        let path = folder.path().join(format!("{name}.oct"));
        let packed = folder.path().join(format!("{name}.packed.oct"));
        write(&mesh, &path, brick, None);
        write(&mesh, &packed, brick, Some(1));
        let mapped = Octree::open(&path).unwrap();
        let rays = rays(&mesh, 1500, 5);
        let least = Octree::least_cache(&path).unwrap();
        let pages = mapped.header().pages;
        assert!(pages > 20, "{name}: {pages} pages");
        for (cache, path) in [(least, &path), (3 * least, &path), (least, &packed), (u64::from(pages) * least, &packed)]
        {
            for threads in [1, 2] {
                let octree = budgeted(path, cache);
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let name = format!("{name}, {cache} bytes of {}, {threads} threads", path.display());
                pool.install(|| compare(&name, &mapped, &octree, &rays));
                let figures = octree.figures();
                println!("{name}: {figures:?}");
                assert!(figures.most_bytes <= cache, "{name}: {figures:?}");
            }
        }
        let small = budgeted(&path, least);
        let unpacked: u64 = small.records().iter().map(|r| u64::from(r.bytes)).sum();
        assert!(name != "sphere" || unpacked >= 8 * least, "{unpacked} bytes of pages, {least} of cache");
        compare(name, &mapped, &small, &rays);
        assert!(small.figures().reread > u64::from(pages), "{name}: {:?}", small.figures());
    }
}

#[test]
fn one_ray_at_a_time_and_boxes() {
    let mesh = Mesh::sphere(5, 0.05);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sphere.oct");
    write(&mesh, &path, 100, None);
    let (mapped, small) = (Octree::open(&path).unwrap(), budgeted(&path, Octree::least_cache(&path).unwrap()));
    let (expected, tracer) = (OctreeTracer::new(&mapped), OctreeTracer::new(&small));
    for ray in &rays(&mesh, 300, 9)[..400] {
        let all = |tracer: &OctreeTracer<&Octree>| -> Vec<[u32; 4]> {
            all_hits(tracer, ray, Skip::NONE).map(|found| bits(found.unwrap().hit)).collect()
        };
        assert_eq!(all(&tracer), all(&expected), "{ray:?}");
        assert_eq!(tracer.any(ray, Skip::NONE).unwrap(), expected.any(ray, Skip::NONE).unwrap());
    }
    let bounds = Aabb { min: [-0.5, -2.0, -2.0].into(), max: [0.5, 2.0, 2.0].into() };
    let inside = |octree: &Octree| {
        let mut faces = Vec::new();
        triangles_in_box(octree, Some(bounds), &mut |stored| {
            // Another page than the one that is being visited.
            OctreeTracer::new(octree).closest(&Ray::new([0.0; 3], [0.1, 0.2, 1.0]), Skip::NONE)?;
            faces.push(stored.face);
            Ok(())
        })
        .unwrap();
        faces
    };
    assert_eq!(inside(&small), inside(&mapped));
    assert!(small.figures().reread > 0);
    assert_eq!(LinearTracer::new(&small).unwrap().triangles(), LinearTracer::new(&mapped).unwrap().triangles());
}

/// Threads that are in each other's way get on.
#[test]
fn many_threads_with_room_for_one_page() {
    let mesh = Mesh::sphere(5, 0.02);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sphere.oct");
    write(&mesh, &path, 100, None);
    let (mapped, small) = (Octree::open(&path).unwrap(), budgeted(&path, Octree::least_cache(&path).unwrap()));
    let rays = rays(&mesh, 2000, 21);
    let (mut expected, mut hits) = (vec![Hit::MISS; rays.len()], vec![Hit::MISS; rays.len()]);
    OctreeTracer::new(&mapped).closest_batch(&rays, &mut expected).unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(6).build().unwrap();
    pool.install(|| OctreeTracer::new(&small).closest_batch(&rays, &mut hits)).unwrap();
    assert!(hits.iter().zip(&expected).all(|(a, b)| bits(*a) == bits(*b)));
}

#[test]
fn a_page_damaged_or_lost_ends_a_batch_with_an_error() {
    let mesh = Mesh::sphere(5, 0.02);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sphere.oct");
    write(&mesh, &path, 100, None);
    let small = budgeted(&path, 3 * Octree::least_cache(&path).unwrap());
    let record = small.records()[small.records().len() / 2];
    let rays = rays(&mesh, 4000, 23);
    let mut hits = vec![Hit::MISS; rays.len()];
    OctreeTracer::new(&small).closest_batch(&rays, &mut hits).unwrap();
    drop(small);
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[record.offset as usize + 100] ^= 4;
    std::fs::write(&path, &bytes).unwrap();
    let small = budgeted(&path, 3 * Octree::least_cache(&path).unwrap());
    let error = OctreeTracer::new(&small).closest_batch(&rays, &mut hits).unwrap_err();
    let page = format!("page {}", small.records().len() / 2);
    assert!(error.kind() == octrace::Kind::Damaged && error.to_string().contains(&page), "{error}");
    // Cut short while it is read.
    let file = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
    bytes[record.offset as usize + 100] ^= 4;
    std::fs::write(&path, &bytes).unwrap();
    let small = budgeted(&path, 3 * Octree::least_cache(&path).unwrap());
    file.set_len(record.offset).unwrap();
    let error = OctreeTracer::new(&small).closest_batch(&rays, &mut hits).unwrap_err();
    assert!(error.kind() == octrace::Kind::Damaged && error.to_string().contains("cut short"), "{error}");
}
