//! The plot of level of detail over `--lod`: how many times as fast, and how many times fewer bytes; and the picture's error. A colour a file.

use octrace::output::drawing::{Anchor, Drawing, Mark, Rgb, Text};

use super::lod::{Level, MANY, SAMPLES};
use super::plot::{AXIS, Axis, COLORS, FINE, GRID, text_at};

const SIZE: [f32; 2] = [1120.0, 460.0];
/// The boxes of the two pairs of axes: left, right, top, bottom.
const GAINS: [f32; 4] = [76.0, 440.0, 66.0, 382.0];
const ERRORS: [f32; 4] = [530.0, 894.0, 66.0, 382.0];
const LEGEND: f32 = 922.0;
const RADIUS: f32 = 5.0;

/// What is measured of one file: the exact picture, then the others.
struct Series<'a> {
    file: &'a str,
    color: Rgb,
    exact: &'a Level,
    levels: Vec<&'a Level>,
}

impl Series<'_> {
    /// How many times as fast as the exact picture each is.
    fn speeds(&self) -> Vec<f64> {
        self.levels.iter().map(|level| level.speedup).collect()
    }

    /// How many times fewer bytes each reads.
    fn bytes(&self) -> Vec<f64> {
        self.levels.iter().map(|level| self.exact.bytes as f64 / level.bytes.max(1) as f64).collect()
    }

    fn errors(&self) -> Vec<f64> {
        self.levels.iter().map(|level| level.rmse_of_many).collect()
    }
}

/// Draws all levels; the exact ones are the measure.
pub fn draw(levels: &[Level], machine: &str) -> Drawing {
    let mut series: Vec<Series<'_>> = Vec::new();
    for level in levels {
        match series.iter_mut().find(|series| series.file == level.file) {
            Some(series) => series.levels.push(level),
            None => {
                let color = COLORS[series.len() % COLORS.len()];
                series.push(Series { file: &level.file, color, exact: level, levels: Vec::new() });
            }
        }
    }
    let mut drawing = Drawing::new(SIZE);
    let title = text_at([GAINS[0], GAINS[2] - 36.0], "Level of detail", Anchor::Start);
    drawing.text(Text { size: 17.0, ..title });
    drawing.text(Text { size: 12.0, ..text_at([ERRORS[1], ERRORS[2] - 36.0], machine, Anchor::End) });
    gains(&mut drawing, &series);
    errors(&mut drawing, &series);
    legend(&mut drawing, &series);
    drawing
}

/// Where the k-th level stands, of those of the longest series; draws the axis below.
fn across(
    drawing: &mut Drawing,
    series: &[Series<'_>],
    [left, right, top, bottom]: [f32; 4],
) -> impl Fn(usize) -> f32 + use<> {
    let longest = series.iter().map(|s| s.levels.as_slice()).max_by_key(|levels| levels.len()).unwrap_or(&[]);
    let step = (right - left) / longest.len().max(1) as f32;
    let at = move |k: usize| left + (k as f32 + 0.5) * step;
    for (k, level) in longest.iter().enumerate() {
        drawing.line(&[[at(k), top], [at(k), bottom]], GRID, 1.0);
        drawing.text(text_at([at(k), bottom + 20.0], &level.lod.to_string(), Anchor::Middle));
    }
    drawing.text(text_at([0.5 * (left + right), bottom + 46.0], "--lod, pixels", Anchor::Middle));
    at
}

fn gains(drawing: &mut Drawing, series: &[Series<'_>]) {
    let [left, right, top, bottom] = GAINS;
    let all = series.iter().flat_map(|s| [s.speeds(), s.bytes()].concat());
    let times = Axis::over(all.chain([1.0, 10.0]), [bottom, top]);
    times.between().for_each(|y| drawing.line(&[[left, y], [right, y]], FINE, 1.0));
    for (power, y) in times.ticks() {
        drawing.line(&[[left, y], [right, y]], GRID, 1.0);
        let decimals = usize::try_from(-power).unwrap_or(0);
        drawing.text(text_at([left - 8.0, y + 4.5], &format!("{:.decimals$}", 10f64.powi(power)), Anchor::End));
    }
    let x = across(drawing, series, GAINS);
    frame(drawing, GAINS, "times the exact picture");
    for s in series {
        for (mark, values) in [(Mark::Circle, s.speeds()), (Mark::Square, s.bytes())] {
            let points: Vec<[f32; 2]> = values.iter().enumerate().map(|(k, v)| [x(k), times.at(*v)]).collect();
            follow(drawing, &points, mark, s.color);
        }
    }
}

fn errors(drawing: &mut Drawing, series: &[Series<'_>]) {
    let [left, right, top, bottom] = ERRORS;
    let all = series.iter().flat_map(|s| s.errors().into_iter().chain([s.exact.rmse_of_many]));
    let step = step(all.fold(1e-6, f64::max));
    // Half a step of room at least.
    let most = step
        * (0.5
            + series
                .iter()
                .flat_map(Series::errors)
                .chain(series.iter().map(|s| s.exact.rmse_of_many))
                .fold(0.0, f64::max)
                / step)
            .ceil();
    let at = |value: f64| bottom - (bottom - top) * (value / most) as f32;
    let decimals = (-step.log10().floor()).max(0.0) as usize;
    for i in 0..=(most / step).round() as u32 {
        let value = f64::from(i) * step;
        drawing.line(&[[left, at(value)], [right, at(value)]], GRID, 1.0);
        drawing.text(text_at([left - 8.0, at(value) + 4.5], &format!("{value:.decimals$}"), Anchor::End));
    }
    let x = across(drawing, series, ERRORS);
    frame(drawing, ERRORS, &format!("RMSE against {MANY} samples, exact, linear"));
    for s in series {
        drawing.line(&[[left, at(s.exact.rmse_of_many)], [right, at(s.exact.rmse_of_many)]], s.color, 1.2);
        let points: Vec<[f32; 2]> = s.errors().iter().enumerate().map(|(k, v)| [x(k), at(*v)]).collect();
        follow(drawing, &points, Mark::Triangle, s.color);
    }
}

/// 1, 2 or 5 times a power of ten, so that there are about five of them up to `most`.
fn step(most: f64) -> f64 {
    let power = 10f64.powf((most / 5.0).log10().floor());
    [1.0, 2.0, 5.0, 10.0].map(|k| k * power).into_iter().find(|step| step * 5.0 >= most * 0.999).unwrap_or(power)
}

/// A line with marks.
fn follow(drawing: &mut Drawing, points: &[[f32; 2]], mark: Mark, color: Rgb) {
    drawing.line(points, color, 1.6);
    points.iter().for_each(|&at| drawing.mark(at, mark, RADIUS, color, true));
}

/// The lines of the axes, and what goes up.
fn frame(drawing: &mut Drawing, [left, right, top, bottom]: [f32; 4], what: &str) {
    drawing.line(&[[left, top], [left, bottom], [right, bottom]], AXIS, 1.2);
    let upward = text_at([left - 60.0, 0.5 * (top + bottom)], what, Anchor::Middle);
    drawing.text(Text { upward: true, ..upward });
}

fn legend(drawing: &mut Drawing, series: &[Series<'_>]) {
    let mut y = GAINS[2] + 12.0;
    for s in series {
        drawing.area([[LEGEND - 6.0, y - 10.0], [LEGEND + 6.0, y + 1.0]], s.color);
        drawing.text(text_at([LEGEND + 16.0, y], s.file, Anchor::Start));
        y += 23.0;
    }
    y += 14.0;
    for (mark, name) in
        [(Mark::Circle, "times as fast"), (Mark::Square, "times fewer bytes"), (Mark::Triangle, "error")]
    {
        drawing.mark([LEGEND, y - 4.5], mark, RADIUS, AXIS, true);
        drawing.text(text_at([LEGEND + 16.0, y], name, Anchor::Start));
        y += 23.0;
    }
    drawing.line(&[[LEGEND - 8.0, y - 4.5], [LEGEND + 8.0, y - 4.5]], AXIS, 1.2);
    drawing.text(text_at([LEGEND + 16.0, y], &format!("exact, {SAMPLES} samples"), Anchor::Start));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_round() {
        assert_eq!([0.9, 5.0, 0.021, 1e-3].map(step), [0.2, 1.0, 0.005, 0.0002]);
    }

    #[test]
    fn each_file_has_its_lines() {
        let level = |file: &str, lod: f64| Level {
            file: file.to_owned(),
            triangles: 9,
            across: 64,
            lod,
            seconds: 1.0 / (1.0 + lod),
            speedup: 1.0 + lod,
            pages: 1,
            pages_total: 2,
            bytes: 1000,
            hits: 3,
            rays: 4,
            largest_claim: lod,
            rmse: 0.01 * lod,
            largest_difference: 0.1,
            rmse_of_many: 0.02,
        };
        let levels: Vec<Level> =
            ["a", "b"].iter().flat_map(|file| [0.0, 1.0, 4.0].map(|lod| level(file, lod))).collect();
        let svg = draw(&levels, "a machine").svg();
        // Two of two levels each, a file; two in the legend beside the triangle.
        assert_eq!(svg.matches("<circle").count(), 2 * 2 + 1);
        assert!(
            ["a machine", ">a<", ">b<", "--lod, pixels", ">10<", ">0.01"].iter().all(|text| svg.contains(text)),
            "{svg}"
        );
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        let empty = draw(&[], "none").svg();
        assert!(!empty.contains("NaN") && !empty.contains("inf"));
    }
}
