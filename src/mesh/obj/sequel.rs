//! What is carried from block to block: counts, the line number, the material in force.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::ops::Range;

use super::forward::Forward;
use super::parse::{Context, KINDS, NAMES, Parsed, Problem, parse_known};
use super::place::{decode, diagnose};
use crate::error::{Error, Result, Severity};
use crate::event::{Event, Monitor};
use crate::mesh::input::Input;
use crate::mesh::{FaceBatch, MeshSink, ReadOptions};

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
    numbers: HashMap<String, u32>,
    materials: Vec<String>,
    libraries: Vec<String>,
    forward: Forward,
    too_few: u64,
    bad: u64,
    skipped: u64,
}

/// What is known at the end.
pub(super) struct End {
    pub counts: [u64; KINDS],
    pub materials: Vec<String>,
    pub libraries: Vec<String>,
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
            numbers: HashMap::new(),
            materials: Vec::new(),
            libraries: Vec::new(),
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
            let name = decode(&text[library]);
            if !self.libraries.contains(&name) {
                self.libraries.push(name);
            }
        }
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
            self.material = self.number_of(text, name);
            if self.materials.len() > self.options.most_materials {
                let most = self.options.most_materials;
                let what =
                    format!("it uses more than {most} materials, which do not fit in the memory allowed; allow more");
                return Err(Error::Input { file: self.error_path.clone(), what });
            }
            match holds.last_mut() {
                Some(last) if last.0 == face as u32 => last.1 = self.material,
                Some(last) if last.1 == self.material => {}
                _ => holds.push((face as u32, self.material)),
            }
        }
        Ok(())
    }

    fn number_of(&mut self, text: &[u8], name: Range<usize>) -> u32 {
        if name.is_empty() {
            return 0;
        }
        let next = self.materials.len() as u32 + 1;
        match self.numbers.entry(decode(&text[name])) {
            Entry::Occupied(known) => *known.get(),
            Entry::Vacant(new) => {
                self.materials.push(new.key().clone());
                *new.insert(next)
            }
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
