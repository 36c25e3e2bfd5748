//! How a picture is made within a bound on memory.
//!
//! What is left of the bound beside the film is shared between waves of rays and pages. Large waves let rays wait while others go
//! on, so that threads hardly ever wait for a page, and each page serves more rays while it is there; but what waves take, pages cannot have.

use super::tiles::{self, Settings};
use crate::error::Result;
use crate::scene::Scene;
use crate::shade::Wave;

/// Fewest samples that a thread follows together, and most.
const WAVES: [usize; 2] = [1024, 1 << 16];
/// Tiles that each thread should have at least, so that all end at about the same time.
const TILES: usize = 8;
/// One part in so many of what film and tiles leave goes to waves, at most.
const SHARE: u64 = 3;
/// Bytes that writing a pixel takes, beside the film's: a copy in the file's format, and the file. Pages are gone by then.
const WRITING: u64 = 24;

/// A picture's share of memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Samples that each thread follows together.
    pub wave: usize,
    /// Side of a tile in pixels.
    pub tile: u32,
    /// Bytes for pages.
    pub pages: u64,
}

impl Plan {
    /// The plan of a picture of this scene on `threads` threads in `memory` bytes, of which pages need at least `pages`; `aovs` pictures of
    /// data are made after it.
    ///
    /// Errors: the least memory, if that is more; settings that make no picture.
    pub fn new(
        scene: &Scene,
        settings: &Settings,
        aovs: usize,
        threads: usize,
        memory: u64,
        pages: u64,
    ) -> Result<Result<Plan, u64>> {
        let [width, height] = tiles::region(scene, settings)?;
        let samples = tiles::samples_side(scene, settings)?.pow(2);
        let pixels = u64::from(width) * u64::from(height);
        // Pictures of data are made and written while pages are there.
        let film = pixels * if aovs > 0 { 12 + WRITING + 12 * aovs as u64 } else { 12 };
        let refracts = scene.materials.iter().any(|material| material.transmit != 0.0);
        let each = (Wave::sample_bytes(refracts) * threads) as u64;
        // The sums and colours of a tile's pixels, of which there are no more than samples but for the rounding of sides.
        let least = film + WAVES[0] as u64 * (each + 60 * threads as u64) + pages.max(WRITING * pixels);
        let Some(rest) = memory.checked_sub(least) else { return Ok(Err(least)) };
        let most = (pixels * u64::from(samples) / (TILES * threads) as u64).max(1);
        let mut wave = WAVES[0];
        while wave < WAVES[1] && (wave as u64) < most && 2 * wave as u64 * (each + 60 * threads as u64) <= rest / SHARE
        {
            wave *= 2;
        }
        let side = (wave as u64 / u64::from(samples)).max(1).isqrt().next_multiple_of(8).max(16) as u32;
        let waves = wave as u64 * (each + 60 * threads as u64);
        let pages = memory - film - waves.min(memory - film);
        Ok(Ok(Plan { wave, tile: side, pages }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_add_up_to_the_memory() {
        let scene = Scene { size: [1024, 1024], samples: 1, ..Scene::default() };
        let settings = Settings::default();
        let least = Plan::new(&scene, &settings, 0, 2, 0, 1 << 20).unwrap().unwrap_err();
        assert!(Plan::new(&scene, &settings, 0, 2, least, 1 << 20).unwrap().is_ok());
        let mut before = 0;
        for memory in [least, 64 << 20, 100 << 20, 256 << 20, 1 << 30, 1 << 40] {
            let plan = Plan::new(&scene, &settings, 0, 2, memory, 1 << 20).unwrap().unwrap();
            let waves = (2 * plan.wave * Wave::sample_bytes(false)) as u64;
            assert!(plan.pages + waves + (12 << 20) <= memory && plan.pages >= 1 << 20, "{memory}: {plan:?}");
            assert!(plan.wave >= before && plan.wave.is_power_of_two(), "{memory}: {plan:?}");
            assert!(plan.tile as usize * plan.tile as usize >= plan.wave, "{memory}: {plan:?}");
            before = plan.wave;
        }
        assert_eq!(before, 1 << 16);
        let odd = Settings { samples: Some(5), ..settings };
        assert!(matches!(Plan::new(&scene, &odd, 0, 2, 1 << 30, 0), Err(crate::Error::Option(_))));
    }
}
