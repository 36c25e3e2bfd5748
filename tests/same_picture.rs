//! One picture, however its mesh was built and however many threads draw it: byte for byte the same PNG.

use std::fs;
use std::path::Path;

use assert_cmd::Command;

/// Shadows, a mirror and the bunny, looked at from near.
const SCENE: &str = "\
resolution 48 40
samples 4
lookat -0.07 0.20 0.38   -0.017 0.100 0   0 1 0
fov 30
light -0.35 0.60 0.35   0.8
mat diff 0.5 0.5 0.6
reflect 0.4
plane 0 0.033 0   0 1 0
reflect 0
mat diff 0.9 0.8 0.7
";

/// Runs a tool in `folder`, which must do without complaint.
fn run(tool: &str, folder: &Path, words: &str) {
    Command::cargo_bin(tool).unwrap().current_dir(folder).arg("-q").args(words.split(' ')).assert().success();
}

#[test]
fn no_way_of_building_or_drawing_changes_a_byte() {
    let temp = tempfile::tempdir().unwrap();
    let folder = temp.path();
    let bunny = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/bunny.obj");
    fs::copy(bunny, folder.join("bunny.obj")).unwrap();
    fs::write(folder.join("fast.txt"), format!("{SCENE}oct bunny.oct\n")).unwrap();
    fs::write(folder.join("slow.txt"), format!("{SCENE}oct off\noct bunny.oct\n")).unwrap();
    let draw = |words: &str| {
        run("octrender", folder, &format!("{words} -o picture.png"));
        fs::read(folder.join("picture.png")).unwrap()
    };
    run("octbuild", folder, "bunny.obj -o bunny.oct");
    let first = draw("fast.txt --threads 1");
    assert!(first == draw("fast.txt --threads 2"), "threads");
    // Every triangle for every ray is slow: a part of the picture with ears, body and floor will do.
    let part = "--samples 1 --crop 16,4,28,36";
    assert!(draw(&format!("fast.txt {part}")) == draw(&format!("slow.txt {part}")), "every triangle");
    for options in [
        "--split sah --leaf 1",
        "--split sah --leaf 2",
        "--split sah --leaf 8",
        "--split sah --brick 500",
        "--split octree",
        "--split octree --cell 1 --leaf 1",
        "--split octree --leaf 8 --brick 500",
        "--split strict",
        "--split strict --cell 2 --leaf 2",
        "--split strict --cell 64 --brick 500",
        "--split strict --cell 8 --depth 6",
        "--split octree --cell 64 --depth 12",
        "--split octree --cell 1000000 --depth 0",
        "--split octree --cell 8 --brick 64",
        "--split sah --brick 7 --leaf 3",
        "--split sah --no-ids --threads 1",
        "--split sah --compress zstd",
        "--split sah --brick 500 --compress zstd:1",
        "--split octree --cell 8 --brick 64 --compress zstd:19",
        "--split strict --compress zstd:3",
    ] {
        run("octbuild", folder, &format!("bunny.obj -o bunny.oct {options}"));
        assert!(first == draw("fast.txt"), "{options}");
    }
    // On a grid the bunny is another one, but the same whether it is packed or not.
    run("octbuild", folder, "bunny.obj -o bunny.oct --positions grid:0.001");
    let coarse = draw("fast.txt");
    assert!(first != coarse, "a grid of a millimetre");
    run("octbuild", folder, "bunny.obj -o bunny.oct --positions grid:0.001 --brick 500 --compress zstd");
    assert!(coarse == draw("fast.txt"), "on a grid, packed");
    // The faces in another order: by the last digits of their line numbers.
    let text = fs::read_to_string(folder.join("bunny.obj")).unwrap();
    let (faces, rest): (Vec<&str>, Vec<&str>) = text.lines().partition(|line| line.starts_with("f "));
    let shuffled = (0..997).rev().flat_map(|k| faces.iter().skip(k).step_by(997));
    let lines: Vec<&str> = rest.into_iter().chain(shuffled.copied()).collect();
    fs::write(folder.join("bunny.obj"), lines.join("\n") + "\n").unwrap();
    run("octbuild", folder, "bunny.obj -o bunny.oct");
    assert!(first == draw("fast.txt"), "face order");
}
