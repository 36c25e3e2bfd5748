//! Pieces of arguments: sizes, points, boxes, image sizes, and the flags that every tool has.

use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use octrace::Error;
use octrace::geometry::Aabb;

/// Flags that every tool has.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "General")]
pub struct Common {
    /// Threads to work with [default: as many as the machine has]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// No progress and no summary; warnings and errors remain
    #[arg(short, long, global = true)]
    pub quiet: bool,
}

/// The flag for statistics.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "General")]
pub struct StatsFile {
    /// Write statistics as JSON to FILE; `-` is standard output
    #[arg(long, value_name = "FILE")]
    pub stats: Option<PathBuf>,
}

impl StatsFile {
    /// Refuses `--stats -` in a tool whose standard output carries `data`.
    pub fn not_stdout(&self, data: &str) -> Result<(), Error> {
        match &self.stats {
            Some(path) if is_stdio(path) => Err(Error::Option(format!(
                "--stats - cannot be used here, since standard output carries {data}; name a file"
            ))),
            _ => Ok(()),
        }
    }

    /// Refuses, before any work is done, a place where they could not be put.
    pub fn check(&self) -> Result<(), Error> {
        self.stats.as_deref().filter(|path| !is_stdio(path)).map_or(Ok(()), super::output::check)
    }

    /// Writes the statistics, if they were asked for.
    pub fn write(&self, stats: &impl serde::Serialize) -> Result<(), Error> {
        self.stats.as_deref().map_or(Ok(()), |path| super::stats::write(path, stats))
    }
}

/// Whether a path means standard input or output.
pub fn is_stdio(path: &Path) -> bool {
    path.as_os_str() == "-"
}

/// Makes rayon's global pool, as large as asked for.
pub fn use_threads(threads: Option<u16>) -> Result<(), Error> {
    let pool = rayon::ThreadPoolBuilder::new();
    match threads {
        Some(threads) => pool
            .num_threads(threads.into())
            .build_global()
            .map_err(|e| Error::Option(format!("cannot start {threads} threads: {e}; ask for fewer"))),
        // Here and not when it is first used, where rayon would panic if threads cannot be had.
        None => pool.build_global().map_err(|e| {
            Error::Option(format!("cannot start a thread for each processor: {e}; ask for fewer (--threads)"))
        }),
    }
}

/// A size in bytes: `4096`, `64M`, `1.5GiB`. K, M, G, T are powers of 1024, with or without `B` or `iB`.
pub fn size(text: &str) -> Result<u64, String> {
    let digits = text.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(text.len());
    let number: f64 = text[..digits].parse().map_err(|_| "expected a size like 64M or 1.5GiB".to_owned())?;
    let unit = text[digits..].trim().to_ascii_lowercase();
    let unit = unit.strip_suffix("ib").or(unit.strip_suffix('b')).unwrap_or(&unit);
    let shift = match unit {
        "" => 0,
        "k" => 10,
        "m" => 20,
        "g" => 30,
        "t" => 40,
        _ => return Err(format!("`{}` is no unit of size; use K, M, G or T", &text[digits..])),
    };
    let bytes = number * (1u64 << shift) as f64;
    if bytes < u64::MAX as f64 {
        Ok(bytes.round() as u64)
    } else {
        Err("more than can be counted; give less than 16777216T".to_owned())
    }
}

/// An image size: `WIDTHxHEIGHT`, both from 1 to 65536, as scenes may have.
pub fn image_size(text: &str) -> Result<[u32; 2], String> {
    let wrong = || "expected WIDTHxHEIGHT, such as 1920x1080, each from 1 to 65536".to_owned();
    let (w, h) = text.split_once(['x', 'X']).ok_or_else(wrong)?;
    let side = |s: &str| s.parse::<u32>().ok().filter(|n| (1..=65536).contains(n)).ok_or_else(wrong);
    Ok([side(w)?, side(h)?])
}

/// `N` numbers with commas between them.
fn numbers<T: std::str::FromStr, const N: usize>(text: &str, form: &str) -> Result<[T; N], String> {
    let wrong = || format!("expected {form}, {N} numbers with commas between them");
    let list: Vec<T> = text.split(',').map(|s| s.trim().parse().map_err(|_| wrong())).collect::<Result<_, _>>()?;
    list.try_into().map_err(|_| wrong())
}

/// A point: `X,Y,Z`, finite.
pub fn point(text: &str) -> Result<DVec3, String> {
    let p = DVec3::from_array(numbers::<f64, 3>(text, "X,Y,Z")?);
    if p.is_finite() { Ok(p) } else { Err("the numbers must be finite".to_owned()) }
}

/// A part of an image: `X0,Y0,X1,Y1` in pixels from the top left corner, `X1` and `Y1` not included.
pub fn pixels(text: &str) -> Result<[u32; 4], String> {
    let [x0, y0, x1, y1] = numbers::<u32, 4>(text, "X0,Y0,X1,Y1")?;
    if x0 < x1 && y0 < y1 {
        Ok([x0, y0, x1, y1])
    } else {
        Err("nothing lies in it: X0 must be less than X1, and Y0 less than Y1".to_owned())
    }
}

/// Which triangles: all, or those that touch a box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Part {
    /// All.
    All,
    /// Those that touch this closed box.
    Box(Aabb),
}

/// A part of a mesh: `all` or `X0,Y0,Z0,X1,Y1,Z1`.
pub fn part(text: &str) -> Result<Part, String> {
    if text == "all" {
        return Ok(Part::All);
    }
    let c = numbers::<f32, 6>(text, "`all` or X0,Y0,Z0,X1,Y1,Z1")?;
    let part = Aabb { min: Vec3::new(c[0], c[1], c[2]), max: Vec3::new(c[3], c[4], c[5]) };
    if part.is_empty() {
        return Err("nothing lies in it: each of X0,Y0,Z0 must be at most its partner in X1,Y1,Z1".to_owned());
    }
    Ok(Part::Box(part))
}

/// A count from 1, or `all` (`u32::MAX`).
pub fn count_or_all(text: &str) -> Result<u32, String> {
    match text {
        "all" => Ok(u32::MAX),
        _ => text.parse().ok().filter(|&n| n > 0).ok_or_else(|| "expected a number from 1, or `all`".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes() {
        assert_eq!(size("4096"), Ok(4096));
        assert_eq!(size("64M"), Ok(64 << 20));
        assert_eq!(size("2G"), Ok(2 << 30));
        assert_eq!(size("1.5GiB"), Ok(3 << 29));
        assert_eq!(size("10kb"), Ok(10 << 10));
        for wrong in ["", "M", "1.5.1M", "64Q", "-1M", "1e9", "99999999999999T"] {
            assert!(size(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn image_sizes() {
        assert_eq!(image_size("640x480"), Ok([640, 480]));
        for wrong in ["640", "640x", "x480", "0x480", "640x-1", "640x480x3", "70000x1"] {
            assert!(image_size(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn points_and_boxes() {
        assert_eq!(point("1,-2.5,3e6"), Ok(DVec3::new(1.0, -2.5, 3e6)));
        for wrong in ["1,2", "1,2,3,4", "1,2,x", "1,2,inf", ""] {
            assert!(point(wrong).is_err(), "{wrong}");
        }
        assert_eq!(part("all"), Ok(Part::All));
        assert!(matches!(part("0,0,0,1,1,1"), Ok(Part::Box(b)) if b.max == Vec3::ONE));
        for wrong in ["1,0,0,0,1,1", "0,0,0,1,1", "0,0,0,1,1,nan", "ALL"] {
            assert!(part(wrong).is_err(), "{wrong}");
        }
        assert_eq!(pixels("0,1,2,3"), Ok([0, 1, 2, 3]));
        assert!(pixels("2,0,2,5").is_err() && pixels("-1,0,2,5").is_err());
    }

    #[test]
    fn counts() {
        assert_eq!(count_or_all("all"), Ok(u32::MAX));
        assert_eq!(count_or_all("7"), Ok(7));
        assert!(count_or_all("0").is_err() && count_or_all("x").is_err());
    }
}
