//! Cases as text, bit for bit: failures that were found, and patterns worth keeping, replayed for ever.
//!
//! ```text
//! # what it is
//! build octree 16 16 21 64       split leaf cell depth brick ("-" = no limit); several lines = several files
//! v 3f800000 00000000 bf800000   a vertex, bits of f32
//! f 0 1 2                        a face, vertices from 0
//! ray OX OY OZ DX DY DZ TMIN TMAX SKIP SKIP closest|all
//! closed                         crossings are even in number
//! ```

use std::collections::HashMap;
use std::path::Path;

use octrace::build::{BuildOptions, Positions};
use octrace::event::Monitor;
use octrace::format::SplitMode;
use octrace::{Error, Result};

use super::judge;
use super::report::FamilyReport;
use crate::families::mesh::Mesh;
use crate::families::{Ask, Case, Probe};
use crate::oracle::OracleRay;

/// A case with the ways to build its file.
#[derive(Default)]
pub struct Replay {
    case: Case,
    builds: Vec<BuildOptions>,
}

const SPLITS: [(&str, SplitMode); 3] =
    [("sah", SplitMode::Sah), ("octree", SplitMode::Octree), ("strict", SplitMode::Strict)];

/// A probe as the words of a `ray` line.
pub fn probe_line(probe: &Probe) -> String {
    let r = &probe.ray;
    let floats = r.o.iter().chain(&r.d).chain([&r.tmin, &r.tmax]);
    let mut words: Vec<String> = floats.map(|x| format!("{:08x}", x.to_bits())).collect();
    words.extend(probe.skip.map(|face| format!("{face:08x}")));
    words.push(if probe.ask == Ask::All { "all" } else { "closest" }.to_owned());
    words.join(" ")
}

/// Rays kept of a case that disagrees, at most.
const MOST_RAYS: usize = 16;

/// Files built to make a case smaller, at most.
const MOST_TRIALS: usize = 300;

/// The case with the rays that disagree only (the first few of them) and with as few triangles as still show a disagreement: ever
/// smaller runs of faces are left out while it lasts (Zeller and Hildebrandt 2002). A case that agrees comes back whole.
pub fn reduced(case: &Case, options: &[BuildOptions]) -> Result<Case> {
    let bench = judge::Bench::new(&case.mesh, options)?;
    let mut wrong = Vec::new();
    for probe in &case.probes {
        if wrong.len() < MOST_RAYS && bench.judge(std::slice::from_ref(probe), case.closed)?.disagreements() > 0 {
            wrong.push(*probe);
        }
    }
    if wrong.is_empty() {
        return Ok(case.clone());
    }
    let mut best = Case { probes: wrong, ..case.clone() };
    let (mut run, mut trials) = (best.mesh.faces.len() / 2, 0);
    while run > 0 && trials < MOST_TRIALS {
        let mut from = 0;
        while from < best.mesh.faces.len() && trials < MOST_TRIALS {
            let fewer = without(&best, from..(from + run).min(best.mesh.faces.len()));
            trials += 1;
            // Without some of its faces a closed mesh is none; the disagreement must show by itself then.
            if !fewer.mesh.faces.is_empty() && judge::run_case(&fewer, options, Monitor::silent())?.disagreements() > 0
            {
                best = fewer;
            } else {
                from += run;
            }
        }
        run /= 2;
    }
    // The smaller mesh may have brought other rays to agree.
    let bench = judge::Bench::new(&best.mesh, options)?;
    let all = std::mem::take(&mut best.probes);
    for probe in all {
        if bench.judge(std::slice::from_ref(&probe), best.closed)?.disagreements() > 0 {
            best.probes.push(probe);
        }
    }
    Ok(best)
}

/// The case without some faces, and without the vertices that only they used.
fn without(case: &Case, faces: std::ops::Range<usize>) -> Case {
    let mut fewer = Case { closed: false, mesh: Mesh::default(), ..case.clone() };
    let kept: Vec<usize> = (0..case.mesh.faces.len()).filter(|k| !faces.contains(k)).collect();
    let (points, mut numbers) = (&mut fewer.mesh.points, HashMap::new());
    let mut renumbered = |v: u32| {
        *numbers.entry(v).or_insert_with(|| {
            points.push(case.mesh.points[v as usize]);
            points.len() as u32 - 1
        })
    };
    fewer.mesh.faces = kept.iter().map(|&k| case.mesh.faces[k].map(&mut renumbered)).collect();
    for skip in fewer.probes.iter_mut().flat_map(|probe| &mut probe.skip) {
        *skip = kept.binary_search(&(*skip as usize)).map_or(u32::MAX, |k| k as u32);
    }
    fewer
}

/// A case as text.
pub fn to_text(title: &str, case: &Case, options: &[BuildOptions]) -> String {
    let mut text = format!("# {title}\n");
    for o in options {
        let split = SPLITS.iter().find(|s| s.1 == o.split).map_or("sah", |s| s.0);
        let brick = o.brick.map_or("-".to_owned(), |n| n.to_string());
        let steps = if o.positions == Positions::LOSSLESS { " steps" } else { "" };
        text += &format!("build {split} {} {} {} {brick}{steps}\n", o.leaf, o.cell, o.depth);
    }
    for p in &case.mesh.points {
        text += &format!("v {:08x} {:08x} {:08x}\n", p[0].to_bits(), p[1].to_bits(), p[2].to_bits());
    }
    case.mesh.faces.iter().for_each(|f| text += &format!("f {} {} {}\n", f[0], f[1], f[2]));
    case.probes.iter().for_each(|p| text += &format!("ray {}\n", probe_line(p)));
    text + if case.closed { "closed\n" } else { "" }
}

/// Reads a case.
pub fn read(path: &Path) -> Result<Replay> {
    let text = std::fs::read_to_string(path).map_err(Error::io(path, "open"))?;
    let mut replay = Replay::default();
    for (number, line) in text.lines().enumerate() {
        let words: Vec<&str> = line.split_whitespace().collect();
        let done = match words.first() {
            None => Some(()),
            Some(word) if word.starts_with('#') => Some(()),
            Some(_) => replay.line(&words),
        };
        done.ok_or_else(|| Error::Input {
            file: path.to_owned(),
            what: format!("line {}: expected build, v, f, ray or closed with their numbers", number + 1),
        })?;
    }
    let points = replay.case.mesh.points.len() as u32;
    if replay.case.mesh.faces.iter().flatten().any(|&v| v >= points) || replay.case.probes.is_empty() {
        let what = "a face names no vertex, or there is no ray".to_owned();
        return Err(Error::Input { file: path.to_owned(), what });
    }
    Ok(replay)
}

fn bits(word: &str) -> Option<u32> {
    u32::from_str_radix(word, 16).ok()
}

fn floats<const N: usize>(words: &[&str]) -> Option<[f32; N]> {
    let list: Option<Vec<f32>> = words.iter().map(|w| bits(w).map(f32::from_bits)).collect();
    list?.try_into().ok()
}

impl Replay {
    fn line(&mut self, words: &[&str]) -> Option<()> {
        match words {
            ["closed"] => self.case.closed = true,
            ["v", p @ ..] => self.case.mesh.points.push(floats(p)?),
            ["f", a, b, c] => self.case.mesh.faces.push([a.parse().ok()?, b.parse().ok()?, c.parse().ok()?]),
            ["build", split, leaf, cell, depth, brick, rest @ ..] => {
                let positions = match rest {
                    [] => Positions::Exact,
                    ["steps"] => Positions::LOSSLESS,
                    _ => return None,
                };
                let options = BuildOptions {
                    split: SPLITS.iter().find(|s| s.0 == *split)?.1,
                    leaf: leaf.parse().ok()?,
                    cell: cell.parse().ok()?,
                    depth: depth.parse().ok()?,
                    brick: if *brick == "-" { None } else { Some(brick.parse().ok()?) },
                    positions,
                    ..BuildOptions::default()
                };
                self.builds.push(options);
            }
            ["ray", rest @ ..] if rest.len() == 11 => {
                let [ox, oy, oz, dx, dy, dz, tmin, tmax] = floats(&rest[..8])?;
                let ask = match rest[10] {
                    "closest" => Ask::Closest,
                    "all" => Ask::All,
                    _ => return None,
                };
                let ray = OracleRay { o: [ox, oy, oz], d: [dx, dy, dz], tmin, tmax };
                self.case.probes.push(Probe { ray, skip: [bits(rest[8])?, bits(rest[9])?], ask });
            }
            _ => return None,
        }
        Some(())
    }

    /// Traces the case with each of its files.
    pub fn run(mut self, name: &str) -> Result<FamilyReport> {
        if self.builds.is_empty() {
            self.builds.push(BuildOptions::default());
        }
        let report = judge::run_case(&self.case, &self.builds, Monitor::silent())?;
        Ok(FamilyReport { name: name.to_owned(), ..report })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::families::ray;

    /// Two triangles one behind the other, said to be closed. A ray that meets one of them disagrees with that; one that meets both
    /// or none does not.
    fn case() -> Case {
        let at = |z: f32, x: f32| [[x, 0.0, z], [x + 4.0, 0.0, z], [x, 4.0, z]];
        let mesh = Mesh::soup([at(0.0, 0.0), at(1.0, 2.0)]);
        let down = |x: f32, y: f32| Probe::all(ray([x, y, 5.0], [0.0, 0.0, -1.0]));
        let probes = vec![down(9.0, 9.0), down(0.5, 0.5), down(2.25, 0.5), down(5.5, 0.25)];
        Case { mesh, probes, closed: true, ..Case::default() }
    }

    #[test]
    fn only_rays_that_disagree_are_kept_and_come_back() {
        let (case, options) =
            (case(), [BuildOptions { brick: Some(7), positions: Positions::LOSSLESS, ..BuildOptions::default() }]);
        let kept = reduced(&case, &options).unwrap();
        let kept_rays: Vec<String> = kept.probes.iter().map(probe_line).collect();
        assert_eq!(kept_rays, [1, 3].map(|k| probe_line(&case.probes[k])));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("case.txt");
        std::fs::write(&path, to_text("a title", &kept, &options)).unwrap();
        let again = read(&path).unwrap();
        assert_eq!(again.builds, options);
        assert_eq!((&again.case.mesh.points, &again.case.mesh.faces), (&kept.mesh.points, &kept.mesh.faces));
        assert_eq!(again.case.probes.iter().map(probe_line).collect::<Vec<_>>(), kept_rays);
        // Each instruction set, packets, many under way, and the test of every triangle.
        let modes = octrace::trace::Isa::available().len() as u64 + 3;
        assert_eq!(again.run("again").unwrap().disagreements(), 2 * modes);
    }

    #[test]
    fn without_a_face_the_others_keep_their_places() {
        let mut case = case();
        case.probes[0].skip = [0, 1];
        let fewer = without(&case, 0..1);
        assert_eq!(fewer.mesh.faces.len(), 1);
        assert_eq!(fewer.mesh.corners(0), case.mesh.corners(1));
        assert_eq!(fewer.mesh.points.len(), 3);
        assert_eq!(fewer.probes[0].skip, [u32::MAX, 0]);
        assert_eq!(fewer.probes[1].skip, [u32::MAX; 2]);
    }
}
