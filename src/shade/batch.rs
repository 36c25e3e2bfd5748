//! Many rays at once against all objects of the scene: each mesh takes its share of them as one batch.
//!
//! The answers are those of [`World::closest`] and [`World::any`] for every ray by itself: which object is asked first changes none of
//! them. Spheres, planes and rectangles are asked ray by ray, as are the objects of a tree, where each ray goes its own way.

use super::object::{Contact, Kind, Part, Placed};
use super::ray::{Omit, WorldRay};
use super::world::World;
use crate::error::Result;
use crate::geometry::{Ray, Skip};
use crate::trace::{Counters, Footprint, Found, Met};

/// Hits nothing.
const NO_RAY: Ray = Ray { origin: [0.0; 3], direction: [0.0; 3], tmin: 0.0, tmax: 0.0 };

/// Rays as one mesh sees them, and its answers; kept so that a batch allocates nothing.
#[derive(Default)]
pub(super) struct Batch {
    rays: Vec<Ray>,
    skips: Vec<Skip>,
    found: Vec<Option<Found>>,
    footprints: Vec<Footprint>,
    met: Vec<Met>,
    blocked: Vec<bool>,
    /// Which of the world's rays each is.
    places: Vec<u32>,
    /// Work done in meshes so far.
    pub counters: Counters,
}

/// Questions whether anything lies on a ray.
#[derive(Default)]
pub(super) struct Questions {
    rays: Vec<WorldRay>,
    omits: Vec<Omit>,
    /// The answers, once asked.
    pub blocked: Vec<bool>,
}

impl Batch {
    /// Bytes a ray.
    pub const BYTES: usize =
        size_of::<Ray>() + size_of::<Skip>() + size_of::<Option<Found>>() + size_of::<bool>() + size_of::<u32>();
    /// Bytes of a ray that waits for a page.
    pub const WAITING: usize = 128;
}

impl Questions {
    /// Bytes a question.
    pub const BYTES: usize = size_of::<WorldRay>() + size_of::<Omit>() + size_of::<bool>();

    /// None.
    pub fn clear(&mut self) {
        self.rays.clear();
        self.omits.clear();
    }

    /// One more.
    pub fn push(&mut self, ray: WorldRay, omit: Omit) {
        self.rays.push(ray);
        self.omits.push(omit);
    }

    /// Questions and answers.
    pub fn answered(&self) -> impl Iterator<Item = (&WorldRay, Omit, bool)> {
        self.rays.iter().zip(&self.omits).zip(&self.blocked).map(|((ray, &omit), &blocked)| (ray, omit, blocked))
    }

    /// Questions, and answers to be corrected.
    pub fn answered_mut(&mut self) -> impl Iterator<Item = (&WorldRay, Omit, &mut bool)> {
        self.rays.iter().zip(&self.omits).zip(&mut self.blocked).map(|((ray, &omit), blocked)| (ray, omit, blocked))
    }
}

impl World {
    /// What each ray meets first, nothing left out; `contacts[i]` answers `rays[i]`.
    pub(super) fn closest_each(
        &self,
        rays: &[WorldRay],
        contacts: &mut Vec<Option<Contact>>,
        batch: &mut Batch,
    ) -> Result<()> {
        contacts.clear();
        contacts.resize(rays.len(), None);
        for &object in &self.always {
            match &self.objects[object as usize].kind {
                Kind::Mesh(placed) => self.nearer_each(object, placed, rays, contacts, batch)?,
                _ => {
                    for (ray, best) in rays.iter().zip(&mut *contacts) {
                        self.nearer(object, ray, Omit::NOTHING, best, &mut batch.counters)?;
                    }
                }
            }
        }
        if self.has_tree() {
            for (ray, best) in rays.iter().zip(contacts) {
                self.nearer_in_tree(ray, Omit::NOTHING, best, &mut batch.counters)?;
            }
        }
        Ok(())
    }

    /// Puts hits of a mesh in the place of those that they come before.
    fn nearer_each(
        &self,
        object: u32,
        placed: &Placed,
        rays: &[WorldRay],
        contacts: &mut [Option<Contact>],
        batch: &mut Batch,
    ) -> Result<()> {
        let Batch { rays: seen, skips, found, footprints, met, counters, .. } = batch;
        let to_local = placed.to_local.as_ref();
        seen.resize(rays.len(), NO_RAY);
        for ((seen, ray), best) in seen.iter_mut().zip(rays).zip(&*contacts) {
            *seen = ray.seen_by(object, to_local, best.as_ref().map_or(ray.tmax, |b| b.t));
        }
        let mesh = &self.meshes[placed.mesh];
        if let Some(pixels) = mesh.pixels {
            footprints.clear();
            footprints.extend(rays.iter().map(|ray| ray.footprint(placed)));
            met.resize(rays.len(), Met::Nothing);
            mesh.tracer.closest_coarse(seen, footprints, pixels, met, counters)?;
            for (met, best) in met.iter().zip(contacts) {
                let (t, part) = match *met {
                    Met::Nothing => continue,
                    Met::Triangle(found) => (found.hit.t, Part::Mesh(found)),
                    Met::Surrogate(surrogate) => (surrogate.t, Part::Surrogate(surrogate)),
                };
                let contact = Contact { t, object, part };
                if best.as_ref().is_none_or(|b| contact.before(b)) {
                    *best = Some(contact);
                }
            }
            return Ok(());
        }
        skips.clear();
        skips.resize(rays.len(), Skip::NONE);
        found.resize(rays.len(), None);
        mesh.tracer.closest_each(seen, skips, found, counters)?;
        for (found, best) in found.iter().zip(contacts) {
            let Some(found) = found else { continue };
            let contact = Contact { t: found.hit.t, object, part: Part::Mesh(*found) };
            if best.as_ref().is_none_or(|b| contact.before(b)) {
                *best = Some(contact);
            }
        }
        Ok(())
    }

    /// Answers all questions; meshes are told that the rays are `short`.
    pub(super) fn any_each(&self, questions: &mut Questions, short: bool, batch: &mut Batch) -> Result<()> {
        let Questions { rays, omits, blocked } = questions;
        blocked.clear();
        blocked.resize(rays.len(), false);
        for &number in &self.always {
            let object = &self.objects[number as usize];
            match &object.kind {
                Kind::Mesh(placed) => self.any_of_mesh(number, placed, short, rays, omits, blocked, batch)?,
                _ => {
                    for ((ray, &omit), blocked) in rays.iter().zip(&*omits).zip(&mut *blocked).filter(|x| !*x.1) {
                        *blocked = object.any(&self.meshes, number, ray, omit, &mut batch.counters)?;
                    }
                }
            }
        }
        if self.has_tree() {
            for ((ray, &omit), blocked) in rays.iter().zip(&*omits).zip(&mut *blocked).filter(|x| !*x.1) {
                *blocked = self.any_in_tree(ray, omit, &mut batch.counters)?;
            }
        }
        Ok(())
    }

    /// Asks a mesh about the rays that nothing else blocks.
    #[expect(clippy::too_many_arguments, reason = "questions in parts, one of which is changed")]
    fn any_of_mesh(
        &self,
        object: u32,
        placed: &Placed,
        short: bool,
        rays: &[WorldRay],
        omits: &[Omit],
        blocked: &mut [bool],
        batch: &mut Batch,
    ) -> Result<()> {
        let Batch { rays: seen, skips, blocked: answers, places, footprints, counters, .. } = batch;
        seen.clear();
        skips.clear();
        places.clear();
        footprints.clear();
        let pixels = self.meshes[placed.mesh].pixels.filter(|_| !short);
        for (i, (ray, omit)) in rays.iter().zip(omits).enumerate().filter(|x| !blocked[x.0]) {
            seen.push(ray.seen_by(object, placed.to_local.as_ref(), ray.tmax));
            skips.push(if omit.object == object { Skip::one(omit.face) } else { Skip::NONE });
            places.push(i as u32);
            if pixels.is_some() {
                footprints.push(ray.footprint(placed));
            }
        }
        answers.resize(seen.len(), false);
        let tracer = &self.meshes[placed.mesh].tracer;
        match (pixels, short) {
            (Some(pixels), _) => tracer.any_coarse(seen, skips, footprints, pixels, answers, counters)?,
            (None, true) => tracer.any_short(seen, skips, answers, counters)?,
            (None, false) => tracer.any_each(seen, skips, answers, counters)?,
        }
        for (&place, &answer) in places.iter().zip(&*answers) {
            blocked[place as usize] = answer;
        }
        Ok(())
    }
}
