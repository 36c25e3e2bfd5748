//! Shapes, lights, transforms and cameras.

use super::*;

#[test]
fn shapes_stand_in_order() {
    let scene = read("sphere 1 2 3 4\ntriangle 0 0 0 1 0 0 0 1 0\nrectangle 0 0 0 2 0 0 2 0 -3\nplane 0 1 0 0 2 0");
    assert_eq!(sphere(&scene, 0), (v(1.0, 2.0, 3.0), 4.0, DAffine3::IDENTITY));
    let Geometry::Triangle(triangle) = scene.shapes[1].geometry else { panic!() };
    assert_eq!(triangle.vertices(), [Vec3::ZERO, Vec3::X, Vec3::Y]);
    let corner = |x, z| Vec3::new(x, 0.0, z);
    let rectangle = [corner(0.0, 0.0), corner(2.0, 0.0), corner(2.0, -3.0), corner(0.0, -3.0)];
    assert_eq!(scene.shapes[2].geometry, Geometry::Rectangle(rectangle));
    assert_eq!(scene.shapes[3].geometry, Geometry::Plane { point: v(0.0, 1.0, 0.0), normal: v(0.0, 1.0, 0.0) });
}

#[test]
fn corners_are_rounded_once() {
    // In f32, 0.1 + 0.7 - 0.3 would be rounded three times; 16777217 is not an f32 at all.
    let scene = read("rectangle 0.1 0 0 0.3 0 0 0.7 1 0\ntranslate 1 0 0\ntriangle 16777216 0 0 1 0 0 0 1 0");
    let Geometry::Rectangle(corners) = scene.shapes[0].geometry else { panic!() };
    assert_eq!(corners[3], Vec3::new((0.1f64 + 0.7 - 0.3) as f32, 1.0, 0.0));
    let Geometry::Triangle(triangle) = scene.shapes[1].geometry else { panic!() };
    assert_eq!(triangle.a.x, 16777217.0f64 as f32);
}

#[test]
fn lights_have_a_color_and_move_with_the_transform() {
    let scene = read(
        "light 1 2 3 .5\nlight 1 2 3 2 1 .5 0\nsun 0 -2 0 1\npush\ntranslate 1 0 0\nrotate 90 0 0 1\nlight 1 0 0 1\nsun 1 0 0 1\npop",
    );
    let point = |position, color| Light::Point { position, color };
    assert_eq!(scene.lights[0], point(v(1.0, 2.0, 3.0), DVec3::splat(0.5)));
    assert_eq!(scene.lights[1], point(v(1.0, 2.0, 3.0), v(2.0, 1.0, 0.0)));
    assert_eq!(scene.lights[2], Light::Sun { direction: v(0.0, -1.0, 0.0), color: DVec3::ONE });
    assert_eq!(scene.lights[3], point(v(1.0, 1.0, 0.0), DVec3::ONE));
    assert_eq!(scene.lights[4], Light::Sun { direction: v(0.0, 1.0, 0.0), color: DVec3::ONE });
}

#[test]
fn transforms_compose_from_the_shape_outward() {
    let scene = read(
        "push\ntranslate 10 0 0\nrotate 90 0 0 1\nscale 2\nsphere 1 0 0 1\npop\nsphere 1 0 0 1\n\
         rotate 90 0 0 1\ntranslate 10 0 0\nsphere 1 0 0 1",
    );
    let (center, radius, to_world) = sphere(&scene, 0);
    assert!(near(center, v(10.0, 2.0, 0.0)), "{center}");
    assert!((radius - 2.0).abs() < 1e-12);
    assert_eq!(to_world, DAffine3::IDENTITY);
    assert_eq!(sphere(&scene, 1), (v(1.0, 0.0, 0.0), 1.0, DAffine3::IDENTITY));
    assert!(near(sphere(&scene, 2).0, v(0.0, 11.0, 0.0)));
}

#[test]
fn rotation_is_right_handed_in_degrees() {
    for (text, from, to) in [
        ("rotate 90 1 0 0", v(0.0, 1.0, 0.0), v(0.0, 0.0, 1.0)),
        ("rotate 90 0 1 0", v(0.0, 0.0, 1.0), v(1.0, 0.0, 0.0)),
        ("rotate 90 0 0 5", v(1.0, 0.0, 0.0), v(0.0, 1.0, 0.0)),
        ("rotate 120 1 1 1", v(1.0, 0.0, 0.0), v(0.0, 1.0, 0.0)),
        ("rotate -450 0 0 1", v(0.0, 1.0, 0.0), v(1.0, 0.0, 0.0)),
        ("rotate 30 0 0 1", v(1.0, 0.0, 0.0), v(0.75f64.sqrt(), 0.5, 0.0)),
    ] {
        let scene = read(&format!("{text}\nsphere {} {} {} 1", from.x, from.y, from.z));
        let center = sphere(&scene, 0).0;
        assert!(near(center, to), "{text}: {center}");
    }
    // Quarter turns about the axes of the world are exact.
    let scene = read("rotate 270 0 1 0\nsphere 1 2 3 1");
    assert_eq!(sphere(&scene, 0).0, v(-3.0, 2.0, 1.0));
}

#[test]
fn spheres_stay_spheres_under_similarities_only() {
    let scene = read("rotate 37 1 2 3\nscale -2\ntranslate 1 1 1\nsphere 0 0 0 3\nscale 1 2 1\nsphere 1 2 3 4");
    let (_, radius, to_world) = sphere(&scene, 0);
    assert!((radius - 6.0).abs() < 1e-9 && to_world == DAffine3::IDENTITY);
    let (center, radius, to_world) = sphere(&scene, 1);
    assert_eq!((center, radius), (v(1.0, 2.0, 3.0), 4.0));
    assert!((to_world.matrix3.determinant() + 16.0).abs() < 1e-9);
}

#[test]
fn planes_keep_their_normal_at_right_angles() {
    let scene = read("translate 0 3 0\nscale 1 2 1\nplane 0 1 0 0 1 1");
    let Geometry::Plane { point, normal } = scene.shapes[0].geometry else { panic!() };
    assert_eq!(point, v(0.0, 5.0, 0.0));
    // (1,0,0) and (0,-1,1) lay in the plane; now (0,-2,1) does.
    assert!(normal.dot(v(0.0, -2.0, 1.0)).abs() < 1e-12 && normal.dot(v(1.0, 0.0, 0.0)).abs() < 1e-12);
    assert!(normal.y > 0.0);
}

#[test]
fn transforms_that_lose_something_are_refused() {
    assert_eq!(error("pop"), "there is no `push` that this `pop` could take back");
    let squash = "scale 1e-38\n".repeat(2);
    assert!(error(&squash).contains("squash everything flat"));
    assert!(error("scale 1e38\nsphere 1e38 0 0 1").contains("too far away"));
    assert!(error("translate 3e38 0 0\nlight 3e38 0 0 1").contains("too far away"));
    assert!(
        error("rectangle -3e38 0 0 -3e38 1 0 3e38 0 0\nrectangle 3e38 0 0 -3e38 1 0 3e38 0 0")
            .contains("fourth corner")
    );
}

#[test]
fn cameras_come_in_three_styles() {
    let classic = "eye 0 0 15\norigin -5 -5 8\nhoriz 10 0 0\nvert 0 10 0\n";
    let rectangle = Camera::Rectangle {
        eye: v(0.0, 0.0, 15.0),
        origin: v(-5.0, -5.0, 8.0),
        horiz: v(10.0, 0.0, 0.0),
        vert: v(0.0, 10.0, 0.0),
    };
    assert_eq!(read(classic).camera, rectangle);
    let look = |fov| Camera::LookAt { eye: v(0.0, 1.0, 2.0), at: v(0.0, 0.0, 0.0), up: v(0.0, 1.0, 0.0), fov };
    assert_eq!(read("lookat 0 1 2  0 0 0  0 1 0").camera, look(45.0));
    assert_eq!(read("fov 30\nlookat 0 1 2  0 0 0  0 1 0").camera, look(30.0));
    assert_eq!(read("lookat 9 9 9 0 0 0 0 1 0\nlookat 0 1 2  0 0 0  0 1 0\nfov 20\nfov 30").camera, look(30.0));
    assert_eq!(read("frame").camera, Camera::Auto);
    let Camera::Frame(direction) = read("frame -1e-200 -2e-200 -2e-200").camera else { panic!() };
    assert!(near(direction, v(-1.0, -2.0, -2.0) / 3.0));
    // Transforms do not touch the camera.
    assert_eq!(read(&format!("translate 1 2 3\n{classic}")).camera, rectangle);
}

#[test]
fn cameras_without_sense_are_refused() {
    assert_eq!(error("eye 0 0 1"), "the camera is incomplete without `origin`, `horiz`, `vert`");
    assert_eq!(error("eye 0 0 1\norigin 0 0 0\nhoriz 1 0 0"), "the camera is incomplete without `vert`");
    assert_eq!(
        error("eye 0 0 1\n\nlookat 0 0 1 0 0 0 0 1 0\norigin 0 0 0\nhoriz 1 0 0\nvert 0 1 0"),
        "`lookat` does not go with `eye` (line 1)"
    );
    assert_eq!(error("frame\nlookat 0 0 1 0 0 0 0 1 0"), "`lookat` does not go with `frame` (line 1)");
    assert!(error("eye 0 0 1\norigin 0 0 0\nhoriz 1 2 0\nvert 2 4 0").contains("no area"));
    assert!(error("eye 0 0 1\norigin 0 0 0\nhoriz 1 0 0\nvert 0 0 0").contains("no area"));
    assert!(error("eye 5 5 0\norigin 0 0 0\nhoriz 1 0 0\nvert 0 1 0").contains("plane of the image"));
    assert!(error("lookat 1 1 1 1 1 1 0 1 0").contains("are the same"));
    assert!(error("lookat 0 5 0 0 0 0 0 1 0").contains("line of sight"));
    assert!(error("lookat 0 5 0 0 0 0 0 0 0").contains("must not be zero"));
}
