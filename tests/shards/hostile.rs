//! Parts that were cut, damaged or never were parts.

use super::{assemble, lab, parts};

#[test]
fn are_refused_by_name_and_no_picture_is_written() {
    let lab = lab();
    let parts = parts(&lab, 3, &["--samples", "4"]);
    let good = lab.read(&parts[1]);
    let with = |bytes: &[u8]| {
        lab.write(&parts[1], bytes);
        let names: Vec<&str> = parts.iter().map(String::as_str).collect();
        let message = lab.fails(2, "octrender", &[&["--assemble"], &names[..], &["-o", "out.png"]].concat());
        assert!(message.contains("scene.part-1-of-3.exr"), "{message}");
        assert!(!lab.path("out.png").exists());
        message
    };
    for length in [0, 7, 100, good.len() / 3, good.len() - 1] {
        let message = with(&good[..length]);
        assert!(message.contains("make this share again"), "{message}");
    }
    // A pixel's byte, in the middle of a packed block.
    let mut flipped = good.clone();
    let middle = good.len() * 2 / 3;
    flipped[middle] ^= 0x10;
    with(&flipped);
    // What it says of itself, one thing after the other.
    let said = |what: &str, with: &str| {
        assert_eq!(what.len(), with.len());
        let at = good.windows(what.len()).position(|w| w == what.as_bytes()).expect(what);
        [&good[..at], with.as_bytes(), &good[at + with.len()..]].concat()
    };
    assert!(with(&said("\"samples\":4", "\"samples\":9")).contains("samples a pixel 9, not 4"));
    assert!(with(&said("\"share\":1", "\"share\":7")).contains("share 7 of 3"));
    assert!(with(&said("\"share\":1", "\"share\":0")).contains("tiles"));
    assert!(with(&said("\"part\":2", "\"part\":9")).contains("version 9"));
    // Another version may say other things.
    let other = with(&said("\"part\":2,\"octrace\"", "\"part\":1,\"OCTRACE\""));
    assert!(other.contains("version 1, and this program reads version 2"), "{other}");
    assert!(with(&said("[150,97]", "[0150,7]")).contains("make this share again"));
    assert!(with(&said("[150,97]", "[1e9,97]")).contains("make this share again"));
    // A picture, and something else altogether.
    lab.done("octrender", &["scene.txt", "-q", "-o", "picture.exr"]);
    assert!(with(&lab.read("picture.exr")).contains("no part"));
    with(b"no EXR at all");
    with(&lab.read("ball.oct"));
    lab.write(&parts[1], &good);
    assemble(&lab, &parts, "out.png");
}
