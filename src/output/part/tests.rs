use exr::compression::Compression;
use exr::meta::BlockDescription;
use exr::meta::attribute::{ChannelDescription, LineOrder, SampleType};
use exr::meta::header::Header;
use exr::prelude::FlatSamples;

use super::*;
use crate::render::{Aov, Film};

fn portion(size: [u32; 2], index: u32, of: u32) -> Portion {
    let share = Share::new(index, of).unwrap();
    let identity = Identity {
        version: "0".into(),
        scene: 0xfeed,
        whole: [size[0] + 3, size[1] + 1],
        crop: [2, 1, size[0] + 2, size[1] + 1],
        samples: 4,
        depth: 7,
        tonemap: ToneMap::Srgb,
    };
    let count = Tiling::new(size, share).unwrap().pixels();
    let value = |i: usize| (i as f32 * 0.37).sin() * 1e3 + 1e-30;
    let pixels = (0..count).map(|i| [value(i), -value(2 * i), f32::from_bits(i as u32)]).collect();
    Portion { identity, share, pixels, data: Vec::new() }
}

/// The same with pictures of data, one of each form.
fn with_data(portion: Portion) -> Portion {
    let count = portion.pixels.len();
    let id = |i: usize| u32::MAX - (i as u32).wrapping_mul(0x9e37_79b9);
    let depths = (0..count).map(|i| if i % 5 == 0 { f32::INFINITY } else { f32::from_bits(i as u32) }).collect();
    let data = vec![
        (AovKind::Depth, Values::Scalar(depths)),
        (AovKind::Normal, Values::Vector((0..count).map(|i| [i as f32, -0.0, 1.0 / i as f32]).collect())),
        (AovKind::Face, Values::Id((0..count).map(id).collect())),
    ];
    Portion { data, ..portion }
}

#[test]
fn parts_read_back_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    for (size, of) in [([64, 48], 5), ([1, 1], 1), ([100, 37], 3), ([1, 1500], 2), ([2100, 9], 1)] {
        for index in 0..of {
            let plain = portion(size, index, of);
            let path = folder.path().join("part.exr");
            for portion in [plain.clone(), with_data(plain)] {
                save_part(&portion, &path).unwrap();
                let part = Part::open(&path).unwrap();
                assert_eq!((&part.identity, part.share), (&portion.identity, portion.share));
                assert!(part.data.iter().eq(portion.data.iter().map(|data| &data.0)));
                let read = part.read().unwrap();
                assert_eq!(read, portion);
                // As bytes, where a sign of zero counts.
                assert!(encode_part(&read).unwrap() == std::fs::read(&path).unwrap());
            }
        }
    }
}

#[test]
fn data_that_does_not_fit_is_refused() {
    let mut short = with_data(portion([64, 48], 0, 5));
    short.data[2].1 = AovKind::Face.nothing(7);
    assert!(encode_part(&short).unwrap_err().to_string().contains("other pixels than its tiles"));
    let mut film = Film::new(64, 48).unwrap();
    let whole = with_data(portion([64, 48], 0, 5));
    whole.put(&mut film).unwrap();
    for (kind, size, fits) in
        [(AovKind::Depth, [64, 48], true), (AovKind::Depth, [48, 64], false), (AovKind::Cost, [64, 48], false)]
    {
        assert_eq!(whole.put_aov(&mut Aov::new(kind, size).unwrap()).is_ok(), fits, "{kind:?} {size:?}");
    }
}

/// A part's bytes with other words in what it says.
fn said_as(good: &[u8], words: &[&str], others: &[&str]) -> Vec<u8> {
    let mut bytes = good.to_owned();
    for (word, other) in words.iter().zip(others) {
        let at = good.windows(word.len()).position(|w| w == word.as_bytes()).unwrap();
        bytes[at..at + other.len()].copy_from_slice(other.as_bytes());
    }
    bytes
}

#[test]
fn what_memory_cannot_hold_is_refused_before_it_is_taken() {
    // The largest picture, with all data: a beginning that holds, and a hole for a file.
    let kinds = AovKind::ALL.map(|kind| (kind, kind.nothing(0)));
    let identity = Identity {
        version: "0".into(),
        scene: 0,
        whole: [65_536; 2],
        crop: [0, 0, 65_536, 65_536],
        samples: 1,
        depth: 1,
        tonemap: ToneMap::None,
    };
    let share = Share::new(0, 1).unwrap();
    let claim = Portion { identity, share, pixels: Vec::new(), data: kinds.into() };
    let tiling = Tiling::new([65_536; 2], share).unwrap();
    let sheet = Sheet::of(&tiling);
    let text = serde_json::to_string(&Said::of(&claim, &tiling)).unwrap();
    let small = Tiling::new([1, 1], share).unwrap();
    let channels = Sheet::of(&small).channels(&claim).list.into_iter().map(|channel| {
        let kind = if matches!(channel.sample_data, FlatSamples::U32(_)) { SampleType::U32 } else { SampleType::F32 };
        ChannelDescription::named(channel.name, kind)
    });
    let mut header = Header::new("".into(), (sheet.size[0], sheet.size[1]), channels.collect()).with_encoding(
        Compression::ZIP16,
        BlockDescription::ScanLines,
        LineOrder::Increasing,
    );
    header.own_attributes.other.insert(Text::from(ATTRIBUTE), AttributeValue::Text(Text::from(text.as_str())));
    let mut bytes = Cursor::new(Vec::new());
    // It has no pixels, of course.
    exr::block::write(&mut bytes, [header].into_iter().collect(), false, |_, _| Ok(())).unwrap_err();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("part.exr");
    std::fs::write(&path, bytes.into_inner()).unwrap();
    let short = Part::open(&path).unwrap_err().to_string();
    assert!(short.contains("cut short"), "{short}");
    File::options().write(true).open(&path).unwrap().set_len(1 << 30).unwrap();
    let part = Part::open(&path).unwrap();
    // 16 channels of 4 GiPixels, as they lie in the file and as they are asked for.
    assert!(part.reading() > 512 << 30, "{}", part.reading());
    let error = part.read().unwrap_err().to_string();
    assert!(error.contains("part.exr") && error.contains("GiB of memory, more than there is"), "{error}");
}

#[test]
fn hostile_parts_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("part.exr");
    let whole = with_data(portion([64, 48], 1, 4));
    let good = encode_part(&whole).unwrap();
    let read = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        Part::open(&path).and_then(|part| part.read())
    };
    read(&good).unwrap();
    // A change to any byte that says something is seen. Whatever is said, it is an error and no panic.
    let mut taken = 0;
    for at in (0..good.len()).step_by(7) {
        for bit in [0x01, 0x80] {
            let mut bytes = good.clone();
            bytes[at] ^= bit;
            match read(&bytes) {
                Ok(portion) => {
                    assert!(portion == whole, "byte {at}");
                    taken += 1;
                }
                Err(error) => assert!(error.to_string().contains("part.exr"), "{error}"),
            }
        }
    }
    assert!(taken < good.len() / 7, "{taken} of {}", good.len() / 7);
    for length in [0, 3, 50, good.len() / 2, good.len() - 1] {
        assert!(read(&good[..length]).is_err(), "{length}");
    }
    let error = |what: &str, with: &str| read(&said_as(&good, &[what], &[with])).unwrap_err().to_string();
    assert!(error("\"part\":2", "\"part\":3").contains("version 3"));
    // One of before there were pictures of data, and one with what is not known yet.
    for version in [1, 3] {
        let other = said_as(&good, &["\"part\":2", "\"data\":"], &[&format!("\"part\":{version}"), "\"DATA\":"]);
        let told = read(&other).unwrap_err().to_string();
        assert!(told.contains(&format!("version {version}, and this program reads version 2")), "{told}");
    }
    assert!(error("\"data\":", "\"DATA\":").contains("DATA"));
    assert!(error("\"share\":1", "\"share\":2").contains("tiles are not those of share 2/4"));
    assert!(error("\"size\":[67,49]", "\"size\":[67,4] ").contains("no picture"));
    assert!(error("\"samples\":4", "\"samples\":9").contains("checksum"));
    assert!(error("\"depth\",\"normal\"", "\"depth\",\"normed\"").contains("in order: depth, normed, face"));
    assert!(error("\"depth\",\"normal\"", "\"depth\",\"depth\" ").contains("in order: depth, depth, face"));
    assert!(error("[\"depth\"", "[ \"cost\"").contains("in order: cost"));
    assert!(error("\"face\"]", "\"cost\"]").contains("size and channels are not those of its share"));
    assert!(error(ATTRIBUTE, "octracePast").contains("no part"));
    // A few bytes that claim a whole wall of pixels.
    let claims = error("\"size\":[67,49],\"crop\":[2,1,66,49]", "\"size\":[67,49],\"crop\":[0,0,67,49]");
    assert!(claims.contains("share"), "{claims}");
    assert!(Part::open(folder.path()).is_err() && Part::open(&folder.path().join("none.exr")).is_err());
}
