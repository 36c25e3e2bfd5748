//! A ray followed from mirror to mirror, for whoever wants to see where it starts each time.
//!
//! Every surface is taken for a perfect mirror, whatever its material. The rays are those of [`World::color`], from the same
//! certified origins: a box of mirrors that no path leaves here shows no light from outside in a picture either.

use super::ray::WorldRay;
use super::whitted::{Ahead, mirror};
use super::world::World;
use crate::error::Result;

/// A path of mirrored rays.
#[derive(Debug)]
pub struct MirrorPath<'w> {
    world: &'w World,
    ahead: Ahead,
}

/// How a path goes on.
#[derive(Clone, Copy, Debug)]
pub enum Bounce {
    /// With this ray, from its certified origin.
    Free(WorldRay),
    /// It is mirrored next by a surface so near that no f32 point lies between.
    Wedged,
}

impl World {
    /// The path that begins with `ray`.
    pub fn mirror_path(&self, ray: WorldRay) -> MirrorPath<'_> {
        MirrorPath { world: self, ahead: Ahead::free(ray) }
    }
}

impl MirrorPath<'_> {
    /// Traces the ray under way and mirrors it. `None` if the ray meets nothing, or if no f32 point lies beside the mirror: the
    /// path ends there, and asking again gives the same answer.
    pub fn bounce(&mut self) -> Result<Option<Bounce>> {
        let Some(meeting) = self.world.meet(&self.ahead)? else { return Ok(None) };
        let departure = self.world.leave(&meeting.spot, true, meeting.path(true))?;
        let direction = self.world.away(&meeting.spot, true, mirror(&meeting.spot, meeting.incoming));
        let Some(ahead) = departure.along(direction) else { return Ok(None) };
        self.ahead = ahead;
        Ok(Some(if self.ahead.is_free() { Bounce::Free(self.ahead.ray) } else { Bounce::Wedged }))
    }
}
