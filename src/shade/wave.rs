//! Many rays followed together (Whitted, "An improved illumination model for shaded display", 1980): what they meet is asked in one
//! batch, then the ways to each light, and so on.
//!
//! Every sample has a stack of the rays that are still to be followed for it; a wave is the topmost ray of every sample that has one. So
//! each sample's contributions are summed in the order of its own depth-first walk, whichever samples share the wave: a
//! colour is the same, bit for bit, alone and in company. A round of a wave is
//!
//! ```text
//! strike:   closest hit of every ray
//! shine:    for each light: colours; origins beside the surfaces, certified (`leave`); shadow rays
//! scatter:  origins for mirrored and refracted rays; the colours are summed, the rays become the next wave
//! ```
//!
//! Memory is a few hundred bytes for each sample, and for each ray that waits on a stack: at most one a bounce.

use glam::DVec3;

use super::batch::{Batch, Questions};
use super::beam::DetailCounts;
use super::leave::{Blocker, Departure};
use super::object::{Contact, Part};
use super::ray::{Omit, Origin, WorldRay};
use super::whitted::{AT_LIGHT, LEAST_WEIGHT, Meeting, RayCounts, mirror, refract};
use super::world::World;
use crate::error::Result;
use crate::geometry::FaceId;
use crate::scene::{Color, Light};
use crate::trace::Counters;

/// Rays of one thread that are followed together, and what became of them.
#[derive(Default)]
pub struct Wave {
    /// Most bounces.
    depth: u32,
    /// Rays traced so far.
    pub counts: RayCounts,
    /// Surrogates that they took for their hits.
    pub detail: DetailCounts,
    /// What each sample has gathered.
    colors: Vec<Color>,
    /// The rays under way, of one sample each, in the samples' order.
    pub(super) front: Front,
    /// Those that come next.
    next: Front,
    /// What is still to be followed for each sample, the next one last.
    waiting: Vec<Vec<(WorldRay, Pending)>>,
    pub(super) contacts: Vec<Option<Contact>>,
    pub(super) struck: Vec<Struck>,
    /// What a light may give, and to which of the struck.
    lit: Vec<(u32, Color)>,
    /// Of which of the struck a departure is wanted.
    wanted: Vec<u32>,
    asks: Asks,
}

/// Working space for questions.
#[derive(Default)]
struct Asks {
    questions: Questions,
    ends: Questions,
    batch: Batch,
}

/// Rays, and what each is for.
#[derive(Default)]
pub(super) struct Front {
    pub rays: Vec<WorldRay>,
    about: Vec<Pending>,
}

/// What a ray's colour counts, and for which sample.
pub(super) struct Pending {
    weight: Color,
    bounces: u32,
    sample: u32,
    /// What the ray is known to meet at once.
    blocker: Option<Box<Blocker>>,
}

/// Where a ray of the front met a surface.
pub(super) struct Struck {
    /// Which ray.
    pub ray: u32,
    pub meeting: Meeting,
    /// Ambient, diffuse and specular light.
    local: Color,
    /// How many lights give some.
    pub lights: u32,
    /// How the surface is left on the side that is seen, once that was asked, and on the other.
    near: Option<Departure>,
    far: Option<Departure>,
}

impl Wave {
    /// For rays of at most `depth` bounces.
    pub fn new(depth: u32) -> Wave {
        Wave { depth, ..Wave::default() }
    }

    /// About how many bytes a sample takes at most, for scenes of few bounces at a time: where rays are `refracted`, more wait.
    pub fn sample_bytes(refracted: bool) -> usize {
        let ray = size_of::<(WorldRay, Pending)>();
        let lists = size_of::<Color>() + 2 * ray + size_of::<Vec<(WorldRay, Pending)>>() + size_of::<Option<Contact>>();
        let lights = size_of::<Struck>() + size_of::<(u32, Color)>() + size_of::<u32>();
        let stack = if refracted { 4 * ray } else { 0 };
        lists + lights + stack + 2 * Questions::BYTES + Batch::BYTES + Batch::WAITING
    }

    /// Begins anew, without rays; the counts go on.
    pub fn clear(&mut self) {
        self.colors.clear();
        self.front.clear();
        self.waiting.iter_mut().for_each(Vec::clear);
    }

    /// Adds a sample: a ray from the eye. Samples are numbered from 0 in the order in which they are added.
    pub fn add(&mut self, ray: WorldRay) {
        let sample = self.colors.len() as u32;
        self.counts.primary += 1;
        self.colors.push(Color::ZERO);
        self.front.push(ray, Pending { weight: Color::ONE, bounces: 0, sample, blocker: None });
    }

    /// Work done in meshes so far, but for what lies about surfaces that are hard to leave.
    pub fn work(&self) -> Counters {
        self.asks.batch.counters
    }

    /// The linear colours that the samples have gathered; whole when [`World::follow`] has no more to do.
    pub fn colors(&self) -> &[Color] {
        &self.colors
    }
}

impl Front {
    fn clear(&mut self) {
        self.rays.clear();
        self.about.clear();
    }

    fn push(&mut self, ray: WorldRay, about: Pending) {
        self.rays.push(ray);
        self.about.push(about);
    }

    /// Takes the last of those that wait, if there is one.
    fn take(&mut self, waiting: &mut Vec<(WorldRay, Pending)>) {
        if let Some((ray, about)) = waiting.pop() {
            self.push(ray, about);
        }
    }
}

impl Struck {
    /// Where the departure on one side is kept.
    fn departure(&mut self, near: bool) -> &mut Option<Departure> {
        if near { &mut self.near } else { &mut self.far }
    }

    /// The direction in which light comes through the surface, and the weight of what it mirrors.
    fn onward(&self) -> (Option<DVec3>, Color) {
        let Meeting { ref spot, incoming, .. } = self.meeting;
        let surface = &spot.surface;
        let refracted = if surface.transmit == 0.0 { None } else { refract(spot, incoming) };
        match refracted {
            Some(_) => (refracted, surface.reflect),
            // Total reflection: the transmitted part is mirrored too.
            None => (None, surface.reflect + Color::splat(surface.transmit)),
        }
    }
}

impl Pending {
    /// Whether a ray of this weight that leaves the surface is to be followed.
    fn goes_on(&self, weight: Color, depth: u32) -> bool {
        let faint = (self.weight * weight).abs().max_element() < LEAST_WEIGHT;
        self.bounces < depth && !faint
    }

    /// About a ray that goes on from here.
    fn then(&self, weight: Color, blocker: Option<Box<Blocker>>) -> Pending {
        Pending { weight: self.weight * weight, bounces: self.bounces + 1, sample: self.sample, blocker }
    }
}

impl World {
    /// The colour along a ray from the eye, linear: a wave of one.
    pub fn color(&self, ray: WorldRay, wave: &mut Wave) -> Result<Color> {
        wave.clear();
        wave.add(ray);
        while self.follow(wave)? {}
        Ok(wave.colors()[0])
    }

    /// Follows each sample's next ray; whether there are more. After an error the wave is to be cleared.
    pub fn follow(&self, wave: &mut Wave) -> Result<bool> {
        if wave.waiting.len() < wave.colors.len() {
            wave.waiting.resize_with(wave.colors.len(), Vec::new);
        }
        self.strike(wave)?;
        for light in &self.scene.lights {
            self.shine(light, wave)?;
        }
        self.scatter(wave)?;
        Ok(!wave.front.rays.is_empty())
    }

    /// Finds what each ray meets.
    pub(super) fn strike(&self, wave: &mut Wave) -> Result<()> {
        let Wave { front, contacts, struck, asks, detail, .. } = wave;
        self.closest_each(&front.rays, contacts, &mut asks.batch)?;
        struck.clear();
        for ((ray, about), (contact, i)) in front.rays.iter().zip(&front.about).zip(contacts.iter().zip(0u32..)) {
            if let Some(Contact { part: Part::Surrogate(met), object, .. }) = contact
                && about.blocker.is_none()
            {
                detail.add(met.error, self.allowed(*object));
            }
            let meeting = match (&about.blocker, contact) {
                (Some(blocker), _) => self.meet_blocker(ray, blocker)?,
                (None, Some(contact)) => self.meet_contact(ray, contact)?,
                (None, None) => continue,
            };
            let local = self.scene.ambient * meeting.spot.surface.ambient;
            struck.push(Struck { ray: i, meeting, local, lights: 0, near: None, far: None });
        }
        Ok(())
    }

    /// Finds how surfaces that were struck are left on one side: origins are made, and asked about together. Those whose way is
    /// known drop out of `wanted`.
    fn depart(&self, struck: &mut [Struck], wanted: &mut Vec<u32>, near: bool, asks: &mut Asks) -> Result<()> {
        let Asks { questions, batch, .. } = asks;
        questions.clear();
        wanted.retain(|&i| {
            let s = &mut struck[i as usize];
            if s.departure(near).is_some() {
                return false;
            }
            let Meeting { spot, .. } = &s.meeting;
            let Some((origin, segment)) = self.first_origin(&spot.side(near), s.meeting.path(near)) else {
                *s.departure(near) = Some(Departure::Nowhere);
                return false;
            };
            if spot.clear().is_some() {
                *s.departure(near) = Some(Departure::Free(origin));
                return false;
            }
            questions.push(segment, spot.omit);
            *s.departure(near) = Some(Departure::Free(origin));
            true
        });
        self.any_each(questions, true, batch)?;
        for (&i, _) in wanted.iter().zip(&questions.blocked).filter(|x| *x.1) {
            let s = &mut struck[i as usize];
            if let Some(Departure::Free(origin)) = *s.departure(near) {
                let past = self.leave_past(&s.meeting.spot.side(near), origin, s.meeting.path(near))?;
                *s.departure(near) = Some(past);
            }
        }
        Ok(())
    }

    /// Adds what a light gives to each surface that was struck.
    pub(super) fn shine(&self, light: &Light, wave: &mut Wave) -> Result<()> {
        let Wave { struck, lit, wanted, asks, counts, .. } = wave;
        lit.clear();
        for (s, i) in struck.iter().zip(0u32..).filter(|x| x.0.meeting.spot.surface.local != 0.0) {
            let color = self.lit(&s.meeting, light);
            if color != Color::ZERO {
                lit.push((i, color));
            }
        }
        wanted.clear();
        wanted.extend(lit.iter().map(|x| x.0));
        self.depart(struck, wanted, true, asks)?;
        let Asks { questions, ends, batch, .. } = asks;
        questions.clear();
        lit.retain(|&(i, _)| {
            let Struck { meeting, near, .. } = &struck[i as usize];
            let Some(Departure::Free(origin)) = near else { return false };
            // The light lies above the face, so the face itself is not in its way; a ball may be in its own.
            let omit = meeting.spot.omit;
            let omit = if omit.face == FaceId::NONE { Omit::NOTHING } else { omit };
            questions.push(meeting.lightward(toward(light, origin)), omit);
            true
        });
        counts.shadow += lit.len() as u64;
        self.any_each(questions, false, batch)?;
        match *light {
            Light::Sun { .. } => {}
            Light::Point { position, .. } => self.pardon(position, questions, ends, batch)?,
        }
        for (&(i, color), _) in lit.iter().zip(&questions.blocked).filter(|x| !x.1) {
            struck[i as usize].local += color;
            struck[i as usize].lights += 1;
        }
        Ok(())
    }

    /// Takes back the answers about ways to a point light that are blocked only behind it, or by what it lies on.
    fn pardon(&self, light: DVec3, ways: &mut Questions, ends: &mut Questions, batch: &mut Batch) -> Result<()> {
        ends.clear();
        for (ray, omit, _) in ways.answered().filter(|x| x.2) {
            ends.push(ray.between(AT_LIGHT[0], AT_LIGHT[1]), omit);
        }
        self.any_each(ends, false, batch)?;
        let mut near_light = ends.blocked.iter();
        for (ray, omit, blocked) in ways.answered_mut().filter(|x| *x.2) {
            if near_light.next() == Some(&true) {
                *blocked = !self.reaches_past(ray, omit, light)?;
            }
        }
        Ok(())
    }

    /// Sums what each ray has found, and sends on what leaves the surfaces.
    fn scatter(&self, wave: &mut Wave) -> Result<()> {
        self.depart_onward(wave)?;
        let Wave { depth, counts, colors, front, next, waiting, struck, .. } = wave;
        next.clear();
        let mut struck = struck.iter().peekable();
        for (about, i) in front.about.iter().zip(0u32..) {
            let (sum, waiting) = (&mut colors[about.sample as usize], &mut waiting[about.sample as usize]);
            let Some(s) = struck.next_if(|s| s.ray == i) else {
                *sum += about.weight * self.scene.background;
                next.take(waiting);
                continue;
            };
            let Meeting { ref spot, incoming, .. } = s.meeting;
            let (refracted, mirrored) = s.onward();
            let mut color = Color::ZERO;
            if spot.surface.local != 0.0 {
                color += s.local * spot.surface.local;
            }
            let ahead = |near: bool, direction| {
                let departure = if near { &s.near } else { &s.far };
                departure.as_ref()?.along(self.away(spot, near, direction))
            };
            if let Some(direction) = refracted {
                let weight = Color::splat(spot.surface.transmit);
                match ahead(false, direction) {
                    None => color += weight * self.scene.background,
                    Some(ahead) => {
                        counts.refracted += 1;
                        waiting.push((s.meeting.refracted(ahead.ray), about.then(weight, ahead.blocker)));
                    }
                }
            }
            let goes_on = mirrored != Color::ZERO && about.goes_on(mirrored, *depth);
            match if goes_on { ahead(true, mirror(spot, incoming)) } else { None } {
                None => {
                    if mirrored != Color::ZERO {
                        color += mirrored * self.scene.background;
                    }
                    next.take(waiting);
                }
                // Before what was refracted here.
                Some(ahead) => {
                    counts.mirror += 1;
                    next.push(s.meeting.mirrored(ahead.ray), about.then(mirrored, ahead.blocker));
                }
            }
            *sum += about.weight * color;
        }
        std::mem::swap(front, next);
        Ok(())
    }

    /// Finds how the rays that go on leave the surfaces that were struck.
    fn depart_onward(&self, wave: &mut Wave) -> Result<()> {
        let Wave { depth, front, struck, wanted, asks, .. } = wave;
        for near in [false, true] {
            wanted.clear();
            for (s, i) in struck.iter().zip(0u32..) {
                let about = &front.about[s.ray as usize];
                let (refracted, mirrored) = s.onward();
                let transmitted = Color::splat(s.meeting.spot.surface.transmit);
                let (wants, weight) =
                    if near { (mirrored != Color::ZERO, mirrored) } else { (refracted.is_some(), transmitted) };
                if wants && about.goes_on(weight, *depth) {
                    wanted.push(i);
                }
            }
            self.depart(struck, wanted, near, asks)?;
        }
        Ok(())
    }
}

/// The way from an origin to a light, to a point light's a little beyond it.
fn toward(light: &Light, origin: &Origin) -> WorldRay {
    match *light {
        Light::Sun { direction, .. } => WorldRay::from(origin, -direction, f32::INFINITY),
        Light::Point { position, .. } => WorldRay::from(origin, position - origin.world, AT_LIGHT[1]),
    }
}
