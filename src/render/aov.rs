//! Arbitrary output variables (the name is RenderMan's, Apodaca and Gritz, "Advanced RenderMan", 2000): pictures of depth, normals,
//! ids, shadows and of the work that a pixel costs. They are made in a pass of their own, and only if asked for: the picture itself pays nothing.

use std::sync::Mutex;

use rayon::prelude::*;

use super::film;
use super::share::{Share, Tiling};
use super::tiles::{Job, Settings};
use crate::error::{Error, Result};
use crate::event::Monitor;
use crate::shade::{Look, Wave, World};

/// Bytes that writing a pixel takes at most, one picture after the other: a copy in the file's format, and the file.
const WRITING: u64 = 24;

/// What a picture of data shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum AovKind {
    /// Distance from the eye, in units of the world; infinite where nothing is met.
    Depth,
    /// Unit normal that is shaded with, on the side that is seen; zero where nothing is met.
    Normal,
    /// Point in the world; zero where nothing is met.
    Position,
    /// Face of the mesh that is seen; [`u32::MAX`] where there is none.
    Face,
    /// Material, as [`Look::material`] counts; [`u32::MAX`] where nothing is met.
    Material,
    /// Nodes and leaves visited for the pixel, by all samples and all rays that they give rise to, each alone.
    Cost,
    /// Pages entered for the pixel, likewise; a page counts each time a ray enters it.
    Pages,
    /// How often a ray of the pixel came to a page that was not in memory; 0 for mapped files. Depends on what was traced before.
    Reads,
    /// Share of the lights that do not reach what is seen, 0 to 1.
    Shadow,
}

/// A picture of data.
#[derive(Clone, Debug, PartialEq)]
pub struct Aov {
    /// What it shows.
    pub kind: AovKind,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Pixels, rows from the top.
    pub values: Values,
}

/// Pixels of a picture of data.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// A number a pixel.
    Scalar(Vec<f32>),
    /// A vector a pixel.
    Vector(Vec<[f32; 3]>),
    /// An id a pixel; [`u32::MAX`] for none.
    Id(Vec<u32>),
}

impl AovKind {
    /// All, in the order in which they are told to users.
    pub const ALL: [AovKind; 9] = [
        AovKind::Depth,
        AovKind::Normal,
        AovKind::Position,
        AovKind::Face,
        AovKind::Material,
        AovKind::Cost,
        AovKind::Pages,
        AovKind::Reads,
        AovKind::Shadow,
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            AovKind::Depth => "depth",
            AovKind::Normal => "normal",
            AovKind::Position => "position",
            AovKind::Face => "face",
            AovKind::Material => "material",
            AovKind::Cost => "cost",
            AovKind::Pages => "pages",
            AovKind::Reads => "reads",
            AovKind::Shadow => "shadow",
        }
    }

    /// The one of that name.
    pub fn named(name: &str) -> Option<AovKind> {
        AovKind::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// Whether it needs what the middle of a pixel sees; the others count work.
    fn looks(self) -> bool {
        !matches!(self, AovKind::Cost | AovKind::Pages | AovKind::Reads)
    }

    /// Bytes of a pixel's value.
    pub fn bytes(self) -> u64 {
        if matches!(self, AovKind::Normal | AovKind::Position) { 12 } else { 4 }
    }

    /// The values of so many pixels in which nothing is met.
    pub fn nothing(self, count: usize) -> Values {
        match self {
            AovKind::Normal | AovKind::Position => Values::Vector(vec![[0.0; 3]; count]),
            AovKind::Face | AovKind::Material => Values::Id(vec![u32::MAX; count]),
            AovKind::Depth => Values::Scalar(vec![f32::INFINITY; count]),
            AovKind::Cost | AovKind::Pages | AovKind::Reads | AovKind::Shadow => Values::Scalar(vec![0.0; count]),
        }
    }
}

impl Aov {
    /// A picture in which nothing is met; fails if memory does not allow it.
    pub fn new(kind: AovKind, [width, height]: [u32; 2]) -> Result<Aov> {
        let count = width as usize * height as usize;
        film::room_for((kind.bytes() + WRITING) * count as u64, || format!("a picture of data of {width} x {height}"))?;
        Ok(Aov { kind, width, height, values: kind.nothing(count) })
    }
}

/// Pictures of data of a world, one for each of `kinds`, on the threads of the current rayon pool.
///
/// All but cost, pages and reads are of one ray through the middle of each pixel, whatever the number of samples. Fails for settings
/// that make no picture, for a damaged page or a failed read, and with [`Error::Interrupted`].
pub fn aovs(world: &World, settings: &Settings, kinds: &[AovKind], monitor: Monitor<'_>) -> Result<Vec<Aov>> {
    let job = Job::new(world, settings)?;
    let (width, height) = (job.width, job.height);
    let bytes = kinds.iter().map(|kind| kind.bytes()).sum::<u64>() + WRITING;
    let count = u64::from(width) * u64::from(height);
    film::room_for(bytes * count, || format!("{} pictures of data of {width} x {height}", kinds.len()))?;
    let rows: Vec<[u32; 4]> = (0..height).map(|y| [0, y, width, y + 1]).collect();
    let values = fill(&job, &rows, kinds, "rows", monitor)?;
    Ok(kinds.iter().zip(values).map(|(&kind, values)| Aov { kind, width, height, values }).collect())
}

/// What [`aovs`] finds for the pixels of a share: tile after tile as in [`Tiling`], rows from the top.
///
/// Fails as that does, and for a share of a picture that has too few tiles.
pub fn share_aovs(
    world: &World,
    settings: &Settings,
    share: Share,
    kinds: &[AovKind],
    monitor: Monitor<'_>,
) -> Result<Vec<(AovKind, Values)>> {
    let job = Job::new(world, settings)?;
    let tiling = Tiling::new([job.width, job.height], share)?;
    let (count, bytes) = (tiling.pixels(), kinds.iter().map(|kind| kind.bytes()).sum::<u64>());
    // Written, they take as much as the part has room for, and at most as much again as a file.
    film::room_for(bytes * (count + 2 * tiling.room()) as u64, || {
        format!("pictures of data of a share of {count} pixels")
    })?;
    let places: Vec<[u32; 4]> = tiling.places().collect();
    let values = fill(&job, &places, kinds, "tiles", monitor)?;
    Ok(kinds.iter().copied().zip(values).collect())
}

/// The values of each kind for the pixels of some places, `[x0, y0, x1, y1]`: place after place, rows from the top. Progress counts `unit`.
fn fill(
    job: &Job<'_>,
    places: &[[u32; 4]],
    kinds: &[AovKind],
    unit: &'static str,
    monitor: Monitor<'_>,
) -> Result<Vec<Values>> {
    monitor.phase("aov");
    let mut count = 0;
    let mut starts = Vec::with_capacity(places.len());
    for [x0, y0, x1, y1] in places {
        starts.push(count);
        count += (x1 - x0) as usize * (y1 - y0) as usize;
    }
    let done = Mutex::new((kinds.iter().map(|kind| kind.nothing(count)).collect::<Vec<_>>(), 0u64));
    places.par_iter().zip(starts).try_for_each_init(
        || Desk { wave: Wave::new(job.depth), looks: Vec::new(), work: Vec::new() },
        |desk, (place, start)| {
            desk.fill(job, *place, kinds, monitor)?;
            job.world.fault()?;
            let (values, places_done) = &mut *done.lock().unwrap_or_else(|poison| poison.into_inner());
            kinds.iter().zip(values).for_each(|(kind, values)| desk.put(*kind, values, start));
            *places_done += 1;
            monitor.progress(*places_done, Some(places.len() as u64), unit);
            Ok(())
        },
    )?;
    Ok(done.into_inner().unwrap_or_else(|poison| poison.into_inner()).0)
}

/// What one thread works with: the pixels of a place.
struct Desk {
    wave: Wave,
    looks: Vec<Option<Look>>,
    /// Nodes and leaves, pages, and waits for pages.
    work: Vec<[f32; 3]>,
}

impl Desk {
    /// Finds what the pixels of a place show.
    fn fill(
        &mut self,
        job: &Job<'_>,
        [x0, y0, x1, y1]: [u32; 4],
        kinds: &[AovKind],
        monitor: Monitor<'_>,
    ) -> Result<()> {
        let Desk { wave, looks, work } = self;
        let pixels = || (y0..y1).flat_map(move |y| (x0..x1).map(move |x| [x, y]));
        let stopped = || if monitor.stopped() { Err(Error::Interrupted) } else { Ok(()) };
        looks.clear();
        work.clear();
        if kinds.iter().any(|kind| kind.looks()) {
            let mut rest = pixels().peekable();
            while rest.peek().is_some() {
                stopped()?;
                wave.clear();
                rest.by_ref().take(job.wave).for_each(|[x, y]| wave.add(job.middle(x, y)));
                job.world.look(wave, kinds.contains(&AovKind::Shadow), looks)?;
            }
        }
        if kinds.iter().all(|kind| kind.looks()) {
            return Ok(());
        }
        for [x, y] in pixels() {
            if x == x0 {
                stopped()?;
            }
            let before = wave.work();
            for s in 0..job.k * job.k {
                job.world.color(job.sample(x, y, s), wave)?;
            }
            let after = wave.work();
            let visits = (after.nodes - before.nodes) + (after.leaves - before.leaves);
            let [pages, waits] = [after.bricks - before.bricks, after.waits - before.waits];
            work.push([visits as f32, pages as f32, waits as f32]);
        }
        Ok(())
    }

    /// Writes it to the values of a kind, from pixel `first` on.
    fn put(&self, kind: AovKind, values: &mut Values, first: usize) {
        let looks = self.looks.iter().zip(first..).filter_map(|(look, i)| Some((i, look.as_ref()?)));
        match (values, kind) {
            (Values::Scalar(to), AovKind::Cost) => {
                to.iter_mut().skip(first).zip(&self.work).for_each(|(v, w)| *v = w[0])
            }
            (Values::Scalar(to), AovKind::Pages) => {
                to.iter_mut().skip(first).zip(&self.work).for_each(|(v, w)| *v = w[1])
            }
            (Values::Scalar(to), AovKind::Reads) => {
                to.iter_mut().skip(first).zip(&self.work).for_each(|(v, w)| *v = w[2])
            }
            (Values::Scalar(to), AovKind::Depth) => looks.for_each(|(i, look)| to[i] = look.depth as f32),
            (Values::Scalar(to), _) => looks.for_each(|(i, look)| to[i] = look.shadow),
            (Values::Vector(to), AovKind::Normal) => {
                looks.for_each(|(i, look)| to[i] = look.normal.as_vec3().to_array())
            }
            (Values::Vector(to), _) => looks.for_each(|(i, look)| to[i] = look.point.as_vec3().to_array()),
            (Values::Id(to), AovKind::Face) => looks.for_each(|(i, look)| to[i] = look.face.0),
            (Values::Id(to), _) => looks.for_each(|(i, look)| to[i] = look.material),
        }
    }
}
