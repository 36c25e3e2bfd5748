//! The phase that few meshes need: large triangles are cut where that pays.

use std::path::Path;

use super::super::checkpoint::State;
use super::super::early::{BLOCK_CUTS, Early};
use super::super::phases::Phases;
use super::super::room::check_parts;
use super::super::spool::Spool;
use super::super::triangles::Stage;
use super::super::work::WorkFolder;
use super::Build;
use crate::error::Result;

impl Build<'_> {
    /// Cuts large triangles where that pays, if it was not done before: then records stand for parts of triangles. Fails if a
    /// brick would not fit in the memory, or the parts on the disk, before more is done.
    pub(super) fn early<'w>(
        &mut self,
        stage: Stage<'w>,
        state: &mut Option<State>,
        (work, output): (&'w WorkFolder, &Path),
        phases: &mut Phases<'_>,
    ) -> Result<Stage<'w>> {
        if state.as_ref().is_some_and(State::has_parts) {
            self.has_parts();
        }
        self.check_memory(self.layout)?;
        let early = Early {
            rule: self.rule,
            layout: self.layout,
            longest: self.mesh.tally.longest,
            block_cuts: BLOCK_CUTS,
            tuning: self.tuning,
            monitor: self.monitor,
        };
        let Stage::Joined(records, _) = &stage else { return Ok(stage) };
        if self.layout.parts || !self.options.ids || !early.is_for(self.report.triangles) {
            return Ok(stage);
        }
        phases.begin("split");
        let Some((cuts, parts)) = early.find(records)? else { return Ok(stage) };
        self.check_memory(early.with_parts())?;
        let words = parts * early.with_parts().words() as u64;
        if words > self.tuning.record_words as u64 {
            let written = if records.memory().is_some() { 0 } else { records.len() };
            check_parts(4 * words, 4 * written, parts, work.temp(), output)?;
        }
        let mut parts = cuts.write(records, Spool::new(work, "parts", self.tuning.record_words).summed())?;
        if let Some(state) = state {
            parts.spill()?;
            state.add_parts(parts.len(), parts.checksum());
            state.save(work)?;
        }
        self.has_parts();
        // Only now may the records of whole triangles go.
        Ok(Stage::Joined(parts, None))
    }

    /// From now on records stand for parts of triangles.
    fn has_parts(&mut self) {
        self.layout.parts = true;
        self.bricks.layout = self.layout;
    }
}
