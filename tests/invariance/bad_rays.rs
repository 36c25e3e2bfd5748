//! Rays that are none hit nothing.

use super::*;

/// Rays that hit nothing, by definition.
fn bad_rays() -> Vec<Ray> {
    let good = Ray::new([0.25, 0.125, 5.0], [0.0, 0.0, -1.0]);
    let mut bad = vec![
        good.between(2.0, 1.0),
        good.between(f32::INFINITY, f32::NEG_INFINITY),
        good.between(f32::NAN, 1.0),
        good.between(0.0, f32::NAN),
        Ray { direction: [0.0; 3], ..good },
        Ray { direction: [0.0, -0.0, 0.0], ..good.between(f32::NEG_INFINITY, f32::INFINITY) },
    ];
    for (i, x) in
        [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY].into_iter().flat_map(|x| [0, 1, 2].map(|i| (i, x)))
    {
        let (mut origin, mut direction) = (good, good);
        origin.origin[i] = x;
        direction.direction[i] = x;
        bad.extend([origin, direction, origin.between(f32::NEG_INFINITY, f32::INFINITY)]);
    }
    bad
}

#[test]
fn bad_rays_miss_in_every_mode() {
    let octree = Mesh::cube(2).octree(&BuildOptions::default());
    let good = Ray::new([0.25, 0.125, 5.0], [0.0, 0.0, -1.0]);
    let linear: Box<dyn Tracer> = Box::new(LinearTracer::new(&octree).unwrap());
    let tracers = Isa::available().into_iter().map(|isa| {
        let tracer: Box<dyn Tracer> = Box::new(OctreeTracer::new(&octree).with_isa(isa));
        tracer
    });
    for tracer in tracers.chain([linear]) {
        let bad: Vec<Query> = bad_rays().into_iter().map(|ray| Query { ray, skip: Skip::NONE }).collect();
        let answers = answers(tracer.as_ref(), &bad);
        assert!(answers.closest.iter().all(|hit| *hit == bits(Hit::MISS)), "{answers:?}");
        assert!(!answers.any.contains(&true) && answers.lists.iter().all(Vec::is_empty));
        for query in &bad {
            assert_eq!(tracer.closest(&query.ray, Skip::NONE).unwrap(), None);
            assert!(!tracer.any(&query.ray, Skip::NONE).unwrap());
        }
        // Legal, whatever they look like.
        let t = |ray: Ray| tracer.closest(&ray, Skip::NONE).unwrap().map(|found| found.hit.t);
        assert_eq!(t(good.between(f32::NEG_INFINITY, f32::INFINITY)), Some(4.0));
        assert_eq!(t(Ray { direction: [0.0, 0.0, 1.0], ..good }.between(-5.0, -1.0)), Some(-4.0));
        assert_eq!(t(good.between(-0.0, f32::INFINITY)), Some(4.0));
        assert_eq!(t(Ray { direction: [0.0, -0.0, -1e-45], ..good }), None, "its t is beyond f32");
        assert_eq!(t(good.between(4.0, 4.0)), Some(4.0));
    }
}

#[test]
fn bad_rays_miss_in_octtrace() {
    let folder = tempfile::tempdir().unwrap();
    let [obj, oct] = ["cube.obj", "cube.oct"].map(|name| folder.path().join(name));
    let mesh = Mesh::cube(2);
    let vertices = mesh.positions.iter().map(|[x, y, z]| format!("v {x} {y} {z}\n"));
    let faces = mesh.faces.iter().map(|f| f.map(|v| v + 1)).map(|[a, b, c]| format!("f {a} {b} {c}\n"));
    std::fs::write(&obj, vertices.chain(faces).collect::<String>()).unwrap();
    let octbuild = env!("CARGO_BIN_EXE_octbuild");
    assert_cmd::Command::new(octbuild).args(["-q", "-o"]).args([&oct, &obj]).assert().success();
    let mut rays = bad_rays();
    rays.push(Ray::new([0.25, 0.125, 5.0], [0.0, 0.0, -1.0]).between(f32::NEG_INFINITY, f32::INFINITY));
    for isa in Isa::available() {
        let mut command = assert_cmd::Command::new(env!("CARGO_BIN_EXE_octtrace"));
        command.arg(&oct).args(["--isa", isa.name()]).write_stdin(bytemuck::cast_slice::<Ray, u8>(&rays).to_vec());
        let output = command.timeout(std::time::Duration::from_secs(60)).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let hits: Vec<Hit> = bytemuck::pod_collect_to_vec(&output.stdout);
        let (last, rest) = hits.split_last().unwrap();
        assert!(last.is_hit() && rest.len() == rays.len() - 1);
        assert!(rest.iter().all(|hit| bits(*hit) == bits(Hit::MISS)), "{}: {rest:?}", isa.name());
    }
}
