//! The picture while it is being drawn: renewed on disk every few seconds, or sent to the viewer tev.
//!
//! Each has a thread of its own, which takes the tiles as they are done; drawing never waits for it. Whatever goes wrong
//! there is a warning.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::Scope;
use std::time::{Duration, Instant};

use octrace::output;
use octrace::render::{Film, Tile};
use octrace::scene::ToneMap;
use octrace::{Monitor, Result};

use crate::place::Place;

/// Who sees the picture before it is done.
#[derive(clap::Args)]
#[command(next_help_heading = "While it is drawn")]
pub struct Live {
    /// Renew the picture on disk every so many seconds with what is done; the rest of it is black
    #[arg(long, value_name = "SECONDS", value_parser = seconds, conflicts_with_all = ["assemble", "shard"])]
    pub preview: Option<f64>,
    /// Send tiles to the viewer tev as they are done (tev listens on port 14158)
    #[cfg(feature = "display")]
    #[arg(long, value_name = "HOST:PORT", conflicts_with = "assemble")]
    pub display: Option<String>,
    /// Draw again whenever the scene changes, or a file that it names; Ctrl-C ends
    #[arg(long, conflicts_with_all = ["assemble", "shard"])]
    pub watch: bool,
}

fn seconds(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|x| (0.1..=86_400.0).contains(x));
    number.ok_or_else(|| "expected a number of seconds, from 0.1 to 86400".to_owned())
}

/// A tile that is done.
#[derive(Clone)]
pub struct Done {
    pub place: [u32; 4],
    pub pixels: Arc<[[f32; 3]]>,
}

/// The picture that is drawn.
#[derive(Clone, Copy)]
pub struct Shown<'a> {
    pub place: &'a Place,
    pub size: [u32; 2],
    pub tonemap: ToneMap,
}

impl Live {
    /// Bytes a pixel that it takes: tiles on their way, a film, and its file.
    pub fn pixel_bytes(&self) -> u64 {
        let preview = if self.preview.is_some() { 12 + 12 + 24 } else { 0 };
        #[cfg(feature = "display")]
        let preview = preview + if self.display.is_some() { 12 + 12 } else { 0 };
        preview
    }

    /// Draws, and shows meanwhile what is done.
    pub fn show<T>(
        &self,
        shown: Shown<'_>,
        monitor: Monitor<'_>,
        draw: impl FnOnce(&(dyn Fn(Tile<'_>) + Sync)) -> Result<T>,
    ) -> Result<T> {
        let film = match (self.preview, shown.place) {
            (Some(period), Place::File(path)) => {
                Some((Film::new(shown.size[0], shown.size[1])?, path, Duration::from_secs_f64(period)))
            }
            _ => None,
        };
        std::thread::scope(|scope| {
            let mut viewers: Vec<Sender<Done>> = Vec::new();
            if let Some((film, path, period)) = film {
                viewers.push(preview(scope, film, path, shown.tonemap, period, monitor));
            }
            #[cfg(feature = "display")]
            let display = self.display.as_deref().map(|host| {
                let (viewer, display) = crate::display::start(scope, host, shown, monitor);
                viewers.push(viewer);
                display
            });
            let result = if viewers.is_empty() {
                draw(&|_| ())
            } else {
                draw(&|tile| {
                    let done = Done { place: tile.place, pixels: tile.pixels.into() };
                    // One that has given up has said so.
                    viewers.iter().for_each(|viewer| viewer.send(done.clone()).unwrap_or_default());
                })
            };
            drop(viewers);
            #[cfg(feature = "display")]
            display.into_iter().for_each(|display| display.finish());
            result
        })
    }
}

/// Starts to renew a picture on disk.
fn preview<'scope, 'a: 'scope>(
    scope: &'scope Scope<'scope, '_>,
    film: Film,
    path: &'a Path,
    tonemap: ToneMap,
    period: Duration,
    monitor: Monitor<'a>,
) -> Sender<Done> {
    let (viewer, tiles) = channel();
    scope.spawn(move || {
        let save = |film: &Film| output::save(film, path, tonemap);
        if let Err(error) = renew(film, &tiles, period, save) {
            monitor.warn(format!("{error}; going on without a preview"));
        }
    });
    viewer
}

/// Takes tiles until there are no more, and saves what there is of the picture `period` after the last time, if it has changed.
fn renew(
    mut film: Film,
    tiles: &Receiver<Done>,
    period: Duration,
    mut save: impl FnMut(&Film) -> Result<()>,
) -> Result<()> {
    let (mut next, mut fresh) = (Instant::now() + period, false);
    loop {
        match tiles.recv_timeout(next.saturating_duration_since(Instant::now())) {
            Ok(done) => {
                film.put_tile(done.place, &done.pixels);
                fresh = true;
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        }
        if Instant::now() >= next {
            if std::mem::take(&mut fresh) {
                save(&film)?;
            }
            next = Instant::now() + period;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_done_is_saved_now_and_then_and_only_if_there_is_something_new() {
        let (viewer, tiles) = channel();
        let saved = std::sync::Mutex::new(Vec::new());
        std::thread::scope(|scope| {
            let save = |film: &Film| {
                saved.lock().unwrap().push(film.clone());
                Ok(())
            };
            let film = Film::new(4, 2).unwrap();
            scope.spawn(move || renew(film, &tiles, Duration::from_millis(30), save).unwrap());
            let count = |n: usize| {
                let start = Instant::now();
                while saved.lock().unwrap().len() < n {
                    assert!(start.elapsed() < Duration::from_secs(20), "{n}");
                    std::thread::sleep(Duration::from_millis(5));
                }
            };
            viewer.send(Done { place: [0, 0, 2, 2], pixels: vec![[1.0; 3]; 4].into() }).unwrap();
            count(1);
            std::thread::sleep(Duration::from_millis(200));
            assert_eq!(saved.lock().unwrap().len(), 1, "nothing was new");
            viewer.send(Done { place: [2, 0, 4, 2], pixels: vec![[2.0; 3]; 4].into() }).unwrap();
            count(2);
            drop(viewer);
        });
        let saved = saved.into_inner().unwrap();
        assert_eq!((saved[0].at(1, 1), saved[0].at(2, 1)), ([1.0; 3], [0.0; 3]));
        assert_eq!((saved[1].at(1, 1), saved[1].at(3, 0)), ([1.0; 3], [2.0; 3]));
    }

    #[test]
    fn a_preview_that_cannot_be_saved_gives_up() {
        let (viewer, tiles) = channel();
        viewer.send(Done { place: [0, 0, 1, 1], pixels: vec![[1.0; 3]].into() }).unwrap();
        let full = |_: &Film| Err(octrace::Error::Option("full".into()));
        let film = Film::new(1, 1).unwrap();
        assert!(renew(film, &tiles, Duration::from_millis(1), full).is_err());
    }
}
