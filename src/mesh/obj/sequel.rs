//! What is carried from block to block: counts, the line number, the material in force.

use super::forward::Forward;
use super::parse::{Context, KINDS, NAMES, Parsed, Problem, parse_known};
use super::place::{decode, diagnose};
use crate::error::{Error, Result, Severity};
use crate::event::{Event, Monitor};
use crate::mesh::input::Input;
use crate::mesh::names::Names;
use crate::mesh::{FaceBatch, MeshSink, ReadOptions, mtl};

/// How many skipped lines are shown one by one.
const SHOWN: u64 = 10;

/// Takes parsed blocks in file order, makes them absolute, and sends them on.
pub(super) struct Sequel {
    file: String,
    error_path: std::path::PathBuf,
    options: ReadOptions,
    counts: [u64; KINDS],
    /// Number of the next block's first line.
    line: u64,
    /// The material in force: 0 is none.
    material: u32,
    materials: Names,
    libraries: Names,
    forward: Forward,
    too_few: u64,
    bad: u64,
    skipped: u64,
}

/// What is known at the end.
pub(super) struct End {
    pub counts: [u64; KINDS],
    pub materials: Names,
    pub libraries: Names,
    pub forward: Forward,
    pub too_few: u64,
    pub bad: u64,
}

impl Sequel {
    /// The beginning of the file.
    pub fn new(input: &Input, options: ReadOptions) -> Sequel {
        Sequel {
            file: input.name(),
            error_path: input.error_path(),
            options,
            counts: [0; KINDS],
            line: 1,
            material: 0,
            materials: Names::default(),
            libraries: Names::default(),
            forward: Forward::new(input.is_repeatable()),
            too_few: 0,
            bad: 0,
            skipped: 0,
        }
    }

    /// The next block, parsed alone, or `None` if something may be wrong with it.
    pub fn take(
        &mut self,
        text: Vec<u8>,
        parsed: Option<Parsed>,
        sink: &mut dyn MeshSink,
        monitor: Monitor<'_>,
    ) -> Result<()> {
        let reaches_back_too_far = |parsed: &Parsed| (0..KINDS).any(|k| parsed.least[k] + (self.counts[k] as i64) < 0);
        let mut parsed = match parsed.filter(|parsed| !reaches_back_too_far(parsed)) {
            Some(parsed) => parsed,
            None => self.parse_again(&text, monitor)?,
        };
        self.make_absolute(&mut parsed);
        self.use_materials(&text, &mut parsed)?;
        for library in parsed.libraries.drain(..) {
            self.libraries.number(&decode(&text[library]));
        }
        self.check_materials()?;
        let after = self.counts_after(&parsed)?;
        if !self.options.lenient {
            self.forward.note(&text, &parsed.greatest, self.counts, after, (&self.file, self.line));
        }
        drop(text);
        send(&parsed, sink)?;
        self.counts = after;
        self.line += parsed.lines;
        self.too_few += parsed.too_few;
        self.bad += parsed.bad;
        Ok(())
    }

    /// The end of the file.
    pub fn finish(self, monitor: Monitor<'_>) -> End {
        if self.skipped > SHOWN {
            monitor.warn(format!("{}: {} more bad lines were skipped", self.file, self.skipped - SHOWN));
        }
        let Sequel { counts, materials, libraries, forward, too_few, bad, .. } = self;
        End { counts, materials, libraries, forward, too_few, bad }
    }

    /// Parses a block in which something is wrong: says what, or (when lenient) skips it and warns.
    fn parse_again(&mut self, text: &[u8], monitor: Monitor<'_>) -> Result<Parsed> {
        let ReadOptions { lenient, origin, .. } = self.options;
        let context = Context::Known { before: self.counts, limits: None, lenient };
        let skipped = &mut self.skipped;
        let mut warn = |problem: Problem| {
            *skipped += 1;
            if *skipped <= SHOWN {
                let found = diagnose(problem, text, self.file.clone(), self.line, Severity::Warning);
                monitor.send(Event::Diagnostic(found));
            }
        };
        parse_known(text, origin, context, &mut warn).map_err(|problem| {
            Error::Text(vec![diagnose(problem, text, self.file.clone(), self.line, Severity::Error)])
        })
    }

    /// Adds the counts before the block to the corners that were relative to it.
    fn make_absolute(&self, parsed: &mut Parsed) {
        let FaceBatch { corners, texcoords, normals, .. } = &mut parsed.faces;
        for (kind, array) in [corners, texcoords, normals].into_iter().enumerate() {
            for run in parsed.relative[kind].drain(..) {
                for index in &mut array[run] {
                    // Both are right modulo 2^32, and so is the sum.
                    *index = index.wrapping_add(self.counts[kind] as u32);
                }
            }
        }
    }

    /// Numbers the materials in the order of first use, and says where each holds.
    fn use_materials(&mut self, text: &[u8], parsed: &mut Parsed) -> Result<()> {
        let holds = &mut parsed.faces.materials;
        holds.push((0, self.material));
        for (face, name) in parsed.uses.drain(..) {
            self.material = match name.is_empty() {
                true => 0,
                false => match self.materials.number(&decode(&text[name])) {
                    Some(number) => number as u32 + 1,
                    None => return Err(too_many_materials(self.error_path.clone(), self.materials.len())),
                },
            };
            match holds.last_mut() {
                Some(last) if last.0 == face as u32 => last.1 = self.material,
                Some(last) if last.1 == self.material => {}
                _ => holds.push((face as u32, self.material)),
            }
        }
        Ok(())
    }

    /// Fails if the materials take more memory than they may.
    fn check_materials(&self) -> Result<()> {
        match mtl::bytes_of(&self.materials) + self.libraries.bytes() <= self.options.material_memory {
            true => Ok(()),
            false => Err(too_many_materials(self.error_path.clone(), self.materials.len())),
        }
    }

    /// The counts after the block, which must stay in the range of indices.
    fn counts_after(&self, parsed: &Parsed) -> Result<[u64; KINDS]> {
        let lengths = [parsed.positions.len(), parsed.texcoords.len(), parsed.normals.len()];
        let after = std::array::from_fn(|kind| self.counts[kind] + lengths[kind] as u64);
        match (0..KINDS).find(|&kind| after[kind] > u32::MAX as u64) {
            None => Ok(after),
            Some(kind) => {
                let what =
                    format!("more than {} {}, the most that can be counted; split the mesh", u32::MAX, NAMES[kind].1);
                Err(Error::Input { file: self.error_path.clone(), what })
            }
        }
    }
}

/// The error for materials that do not fit in the memory, of which at least `count` are used.
pub(super) fn too_many_materials(file: std::path::PathBuf, count: usize) -> Error {
    let what = format!(
        "the {count} and more materials that it uses do not fit in the memory allowed; allow more (about 1 KiB for each)"
    );
    Error::Input { file, what }
}

/// Sends on what a block holds.
fn send(parsed: &Parsed, sink: &mut dyn MeshSink) -> Result<()> {
    if !parsed.positions.is_empty() {
        sink.positions(&parsed.positions)?;
    }
    if !parsed.texcoords.is_empty() {
        sink.texcoords(&parsed.texcoords)?;
    }
    if !parsed.normals.is_empty() {
        sink.normals(&parsed.normals)?;
    }
    if parsed.count > 0 {
        sink.faces(&parsed.faces)?;
    }
    Ok(())
}
