//! One share of a picture: `--shard I/N`, or as the scheduler that started this process counts.

use std::path::{Path, PathBuf};

use octrace::render::Share;
use octrace::{Error, Result};

use crate::cli;
use crate::cli::args::is_stdio;
use crate::place::Place;

/// What `--shard` says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wish {
    /// This share.
    Given(Share),
    /// The one that the scheduler says, of so many, if that is given.
    Scheduled(Option<u32>),
}

/// Reads `I/N`, `auto` or `auto/N`.
pub fn parse(text: &str) -> Result<Wish, String> {
    let wrong = || "expected I/N such as 0/8, auto/N, or auto".to_owned();
    let number = |text: &str| text.parse::<u32>().map_err(|_| wrong());
    match text.split_once('/') {
        None if text == "auto" => Ok(Wish::Scheduled(None)),
        None => Err(wrong()),
        Some(("auto", of)) => {
            let of = number(of)?;
            Share::new(0, of).map_err(|e| e.to_string())?;
            Ok(Wish::Scheduled(Some(of)))
        }
        Some((index, of)) => Ok(Wish::Given(Share::new(number(index)?, number(of)?).map_err(|e| e.to_string())?)),
    }
}

impl Wish {
    /// The share, by the environment where that has to say.
    pub fn share(self) -> Result<Share> {
        self.share_by(|name| std::env::var(name).ok())
    }

    fn share_by(self, variable: impl Fn(&str) -> Option<String>) -> Result<Share> {
        let of = match self {
            Wish::Given(share) => return Ok(share),
            Wish::Scheduled(of) => of,
        };
        let number = |name: &str| -> Result<Option<u32>> {
            let Some(text) = variable(name) else { return Ok(None) };
            let number = text
                .trim()
                .parse()
                .map_err(|_| Error::Option(format!("{name} is `{text}`, which is no number; give --shard I/N")))?;
            Ok(Some(number))
        };
        match (number("SLURM_ARRAY_TASK_ID")?, number("JOB_COMPLETION_INDEX")?, of) {
            (Some(_), Some(_), _) => Err(Error::Option(
                "both Slurm (SLURM_ARRAY_TASK_ID) and Kubernetes (JOB_COMPLETION_INDEX) say which share this is: give --shard I/N".into(),
            )),
            (None, None, _) => Err(Error::Option(
                "--shard auto: neither SLURM_ARRAY_TASK_ID (a Slurm array) nor JOB_COMPLETION_INDEX (an indexed job of Kubernetes) is set: give \
                 --shard I/N"
                    .into(),
            )),
            (Some(index), None, Some(of)) | (None, Some(index), Some(of)) => Share::new(index, of),
            (None, Some(_), None) => {
                Err(Error::Option("Kubernetes does not tell how many completions there are: give --shard auto/N".into()))
            }
            (Some(task), None, None) => {
                let name = |what| format!("SLURM_ARRAY_TASK_{what}");
                let [least, most, count] = ["MIN", "MAX", "COUNT"].map(|what| number(&name(what)));
                whole_array(task, least?, most?, count?)
            }
        }
    }
}

/// The share of a task of an array that is one share a task: 0 to N-1 or 1 to N. Others may be a few tasks of a larger array that are run again.
fn whole_array(task: u32, least: Option<u32>, most: Option<u32>, count: Option<u32>) -> Result<Share> {
    let (Some(least), Some(most), Some(count)) = (least, most, count) else {
        let what = "Slurm does not tell how many tasks the array has (SLURM_ARRAY_TASK_COUNT): give --shard auto/N";
        return Err(Error::Option(what.into()));
    };
    let whole = least <= 1 && most.checked_sub(least).and_then(|x| x.checked_add(1)) == Some(count);
    if !whole || task < least {
        let what = format!(
            "the array's {count} tasks from {least} to {most} are not 0 to N-1 or 1 to N, so that the number of shares is not known: give --shard auto/N \
             (task I makes share I)"
        );
        return Err(Error::Option(what));
    }
    Share::new(task - least, count)
}

/// Where the part goes: where `wish` says, into that folder, or else to the picture's name with `.part-I-of-N.exr`.
pub fn place(wish: Option<&Path>, scene: Option<&Path>, input: &Path, share: Share) -> Result<PathBuf> {
    let exact = wish.filter(|path| !path.is_dir());
    let path = match exact {
        Some(path) => path.to_owned(),
        None => {
            let Place::File(picture) = Place::choose(None, scene, input)? else {
                return Err(Error::Option("a part cannot go to standard output: give -o PART.exr".into()));
            };
            let stem = picture.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            let name = format!("{stem}.part-{}-of-{}.exr", share.index(), share.of());
            wish.map_or_else(|| picture.with_file_name(&name), |folder| folder.join(&name))
        }
    };
    if is_stdio(&path) || path.extension().is_none_or(|suffix| !suffix.eq_ignore_ascii_case("exr")) {
        let what = "a part of a picture is an EXR file: give -o PART.exr, or a folder that is there; the picture is made by --assemble";
        return Err(Error::Option(format!("{}: {what}", path.display())));
    }
    cli::output::check(&path)?;
    if cli::output::same_file(&path, input) {
        return Err(Error::Option(format!("{}: input and output are the same file", path.display())));
    }
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn share(index: u32, of: u32) -> Share {
        Share::new(index, of).unwrap()
    }

    #[test]
    fn wishes() {
        assert_eq!(parse("3/8"), Ok(Wish::Given(share(3, 8))));
        assert_eq!(parse("auto"), Ok(Wish::Scheduled(None)));
        assert_eq!(parse("auto/5"), Ok(Wish::Scheduled(Some(5))));
        for wrong in ["8/8", "-1/8", "3", "3/", "/8", "0/0", "auto/0", "auto/x", "Auto", "1/2/3", ""] {
            assert!(parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn schedulers_say_which_share() {
        let by = |wish: Wish, set: &[(&str, &str)]| {
            wish.share_by(|name| set.iter().find(|x| x.0 == name).map(|x| x.1.to_owned()))
        };
        let slurm = |id: &'static str, min: &'static str, max: &'static str, count: &'static str| {
            [
                ("SLURM_ARRAY_TASK_ID", id),
                ("SLURM_ARRAY_TASK_MIN", min),
                ("SLURM_ARRAY_TASK_MAX", max),
                ("SLURM_ARRAY_TASK_COUNT", count),
            ]
        };
        let (auto, of_8) = (Wish::Scheduled(None), Wish::Scheduled(Some(8)));
        assert_eq!(by(auto, &slurm("3", "0", "7", "8")).unwrap(), share(3, 8));
        assert_eq!(by(auto, &slurm("8", "1", "8", "8")).unwrap(), share(7, 8));
        assert_eq!(by(of_8, &slurm("3", "3", "3", "1")).unwrap(), share(3, 8));
        assert_eq!(by(of_8, &[("JOB_COMPLETION_INDEX", "5")]).unwrap(), share(5, 8));
        assert_eq!(by(Wish::Given(share(1, 2)), &slurm("3", "0", "7", "8")).unwrap(), share(1, 2));
        // A few tasks of a larger array that are run again are no whole picture.
        for few in [slurm("3", "3", "3", "1"), slurm("0", "0", "6", "2"), slurm("4", "0", "9", "5")] {
            let error = by(auto, &few).unwrap_err().to_string();
            assert!(error.contains("auto/N"), "{error}");
        }
        assert!(by(of_8, &slurm("8", "1", "8", "8")).is_err());
        assert!(by(auto, &[("JOB_COMPLETION_INDEX", "5")]).unwrap_err().to_string().contains("auto/N"));
        assert!(by(auto, &[("SLURM_ARRAY_TASK_ID", "x")]).is_err() && by(of_8, &[]).is_err());
        assert!(by(of_8, &[("SLURM_ARRAY_TASK_ID", "1"), ("JOB_COMPLETION_INDEX", "1")]).is_err());
    }

    #[test]
    fn parts_have_names_of_their_own() {
        let folder = tempfile::tempdir().unwrap();
        let place = |wish: Option<&Path>, scene: Option<&str>| {
            place(wish, scene.map(Path::new), Path::new("x/planet.txt"), share(3, 8))
        };
        assert_eq!(place(None, None).unwrap(), Path::new("planet.part-3-of-8.exr"));
        assert_eq!(place(None, Some("far.png")).unwrap(), Path::new("far.part-3-of-8.exr"));
        assert_eq!(place(Some(folder.path()), None).unwrap(), folder.path().join("planet.part-3-of-8.exr"));
        assert_eq!(place(Some("p.exr".as_ref()), None).unwrap(), Path::new("p.exr"));
        assert!(place(Some("p.png".as_ref()), None).is_err() && place(Some("-".as_ref()), None).is_err());
    }
}
