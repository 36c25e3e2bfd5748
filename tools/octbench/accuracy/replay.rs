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

use std::path::Path;

use octrace::build::BuildOptions;
use octrace::event::Monitor;
use octrace::format::SplitMode;
use octrace::{Error, Result};

use super::judge;
use super::report::FamilyReport;
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

/// A case as text.
pub fn to_text(title: &str, case: &Case, probes: &[Probe], options: &[BuildOptions]) -> String {
    let mut text = format!("# {title}\n");
    for o in options {
        let split = SPLITS.iter().find(|s| s.1 == o.split).map_or("sah", |s| s.0);
        let brick = o.brick.map_or("-".to_owned(), |n| n.to_string());
        text += &format!("build {split} {} {} {} {brick}\n", o.leaf, o.cell, o.depth);
    }
    for p in &case.mesh.points {
        text += &format!("v {:08x} {:08x} {:08x}\n", p[0].to_bits(), p[1].to_bits(), p[2].to_bits());
    }
    case.mesh.faces.iter().for_each(|f| text += &format!("f {} {} {}\n", f[0], f[1], f[2]));
    probes.iter().for_each(|p| text += &format!("ray {}\n", probe_line(p)));
    text + if case.closed { "closed\n" } else { "" }
}

/// Reads a case.
pub fn read(path: &Path) -> Result<Replay> {
    let text = std::fs::read_to_string(path).map_err(Error::io(path, "read"))?;
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
            ["build", split, leaf, cell, depth, brick] => {
                let options = BuildOptions {
                    split: SPLITS.iter().find(|s| s.0 == *split)?.1,
                    leaf: leaf.parse().ok()?,
                    cell: cell.parse().ok()?,
                    depth: depth.parse().ok()?,
                    brick: if *brick == "-" { None } else { Some(brick.parse().ok()?) },
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
