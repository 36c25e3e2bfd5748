//! The plot of level of detail: how many times as fast, and how many times fewer bytes, over the picture's error; a colour a file.

use octrace::output::drawing::{Anchor, Drawing, Mark, Text};

use super::lod::Level;
use super::plot::{AXIS, Axis, COLORS, FINE, GRID, text_at};

const SIZE: [f32; 2] = [900.0, 470.0];
/// The axes' box: left, right, top, bottom.
const FRAME: [f32; 4] = [84.0, 640.0, 52.0, 392.0];
const LEGEND: f32 = 664.0;
const RADIUS: f32 = 6.0;
/// The mark of speed and that of bytes.
const MARKS: [(Mark, &str); 2] = [(Mark::Circle, "times as fast"), (Mark::Square, "times fewer bytes read")];

/// Draws all levels but the exact ones, which are the measure.
pub fn draw(levels: &[Level], machine: &str) -> Drawing {
    let [left, right, top, bottom] = FRAME;
    let exact = |level: &Level| levels.iter().find(|other| other.file == level.file && other.lod == 0.0);
    let gains = |level: &Level| {
        let bytes = exact(level).map_or(1.0, |exact| exact.bytes as f64 / level.bytes.max(1) as f64);
        [level.speedup, bytes]
    };
    let shown: Vec<&Level> = levels.iter().filter(|level| level.lod > 0.0 && level.rmse > 0.0).collect();
    let errors = Axis::over(shown.iter().map(|level| level.rmse).chain([1e-3, 1e-2]), [left, right]);
    let times = Axis::over(shown.iter().flat_map(|level| gains(level)).chain([1.0, 10.0]), [bottom, top]);
    let mut drawing = Drawing::new(SIZE);
    axes(&mut drawing, &errors, &times);
    let mut files: Vec<&String> = Vec::new();
    for level in shown {
        if !files.contains(&&level.file) {
            files.push(&level.file);
        }
        let color = COLORS[(files.iter().position(|file| **file == level.file).unwrap_or(0)) % COLORS.len()];
        let x = errors.at(level.rmse);
        for ((mark, _), gain) in MARKS.into_iter().zip(gains(level)) {
            let y = times.at(gain);
            drawing.mark([x, y], mark, RADIUS, color, true);
            let label = text_at([x + 9.0, y - 6.0], &level.lod.to_string(), Anchor::Start);
            drawing.text(Text { size: 11.0, ..label });
        }
    }
    drawing.text(Text { size: 17.0, ..text_at([left, top - 24.0], "Level of detail", Anchor::Start) });
    drawing.text(Text { size: 12.0, ..text_at([right, top - 24.0], machine, Anchor::End) });
    let what = "difference from the exact picture (root mean square, linear); numbers: --lod, in pixels";
    drawing.text(text_at([0.5 * (left + right), bottom + 50.0], what, Anchor::Middle));
    let upward = text_at([20.0, 0.5 * (top + bottom)], "times the exact picture", Anchor::Middle);
    drawing.text(Text { upward: true, ..upward });
    let mut y = top + 6.0;
    for (file, color) in files.iter().zip(COLORS.iter().cycle()) {
        drawing.mark([LEGEND, y - 4.5], Mark::Circle, RADIUS, *color, true);
        drawing.text(text_at([LEGEND + 16.0, y], file, Anchor::Start));
        y += 23.0;
    }
    for (mark, name) in MARKS {
        drawing.mark([LEGEND, y + 13.5], mark, RADIUS, AXIS, false);
        drawing.text(text_at([LEGEND + 16.0, y + 18.0], name, Anchor::Start));
        y += 23.0;
    }
    drawing
}

fn axes(drawing: &mut Drawing, errors: &Axis, times: &Axis) {
    let [left, right, top, bottom] = FRAME;
    errors.between().for_each(|x| drawing.line(&[[x, top], [x, bottom]], FINE, 1.0));
    times.between().for_each(|y| drawing.line(&[[left, y], [right, y]], FINE, 1.0));
    for (power, x) in errors.ticks() {
        drawing.line(&[[x, top], [x, bottom]], GRID, 1.0);
        drawing.text(Text { exponent: power.to_string(), ..text_at([x, bottom + 20.0], "10", Anchor::Middle) });
    }
    for (power, y) in times.ticks() {
        drawing.line(&[[left, y], [right, y]], GRID, 1.0);
        let decimals = usize::try_from(-power).unwrap_or(0);
        drawing.text(text_at([left - 8.0, y + 4.5], &format!("{:.decimals$}", 10f64.powi(power)), Anchor::End));
    }
    drawing.line(&[[left, top], [left, bottom], [right, bottom]], AXIS, 1.2);
}
