//! The plot: share of wrong rays to the right, speed upward, both by powers of ten; a colour a tracer, a mark a set of rays.

use super::report::Row;
use octrace::output::drawing::{Anchor, Drawing, Mark, Rgb, Text};

const SIZE: [f32; 2] = [900.0, 470.0];
/// The axes' box: left, right, top, bottom.
const FRAME: [f32; 4] = [84.0, 630.0, 52.0, 392.0];
/// Width of the strip at the left for rays without any error, which a scale of powers has no place for.
const STRIP: f32 = 124.0;
const LEGEND: f32 = 654.0;
const RADIUS: f32 = 6.0;
const GRID: Rgb = [0xe4; 3];
const FINE: Rgb = [0xf3; 3];
const AXIS: Rgb = [0x55; 3];

/// Colours that most people can tell apart (Okabe and Ito 2008), the first for our own tracer.
const COLORS: [Rgb; 7] = [
    [0x00, 0x72, 0xb2],
    [0xd5, 0x5e, 0x00],
    [0xcc, 0x79, 0xa7],
    [0x00, 0x9e, 0x73],
    [0xe6, 0x9f, 0x00],
    [0x56, 0xb4, 0xe9],
    [0x44, 0x44, 0x44],
];
const MARKS: [Mark; 4] = [Mark::Circle, Mark::Square, Mark::Triangle, Mark::Diamond];

/// Values by powers of ten along a line of pixels.
struct Axis {
    powers: [i32; 2],
    pixels: [f32; 2],
}

impl Axis {
    /// From the power of ten below the least value to the one above the greatest.
    fn over(values: impl Iterator<Item = f64>, pixels: [f32; 2]) -> Axis {
        let (low, high) = values.fold((f64::MAX, f64::MIN_POSITIVE), |(l, h), v| (l.min(v), h.max(v)));
        // A little room, so that no mark lies on the frame.
        let powers = [(low / 1.2).log10().floor() as i32, (high * 1.2).log10().ceil() as i32];
        Axis { powers, pixels }
    }

    fn at(&self, value: f64) -> f32 {
        let [low, high] = self.powers.map(f64::from);
        let share = ((value.log10() - low) / (high - low)).clamp(0.0, 1.0) as f32;
        self.pixels[0] + share * (self.pixels[1] - self.pixels[0])
    }

    fn ticks(&self) -> impl Iterator<Item = (i32, f32)> + '_ {
        (self.powers[0]..=self.powers[1]).map(|power| (power, self.at(10f64.powi(power))))
    }

    /// Two, three, .. nine times each power.
    fn between(&self) -> impl Iterator<Item = f32> + '_ {
        (self.powers[0]..self.powers[1])
            .flat_map(move |power| (2..10).map(move |k| self.at(f64::from(k) * 10f64.powi(power))))
    }
}

/// Draws the rows whose speed is known.
pub fn draw(rows: &[Row], machine: &str) -> Drawing {
    let rows: Vec<(&Row, f64)> = rows.iter().filter_map(|r| Some((r, r.mrays_per_second?))).collect();
    let (tracers, sets) = (each_once(rows.iter().map(|r| &r.0.tracer)), each_once(rows.iter().map(|r| &r.0.set)));
    let [left, right, top, bottom] = FRAME;
    let seen = rows.iter().map(|(r, _)| r.error_rate).filter(|&e| e > 0.0);
    let errors = Axis::over(seen.chain([1e-3, 0.5]), [left + STRIP, right]);
    let speeds = Axis::over(rows.iter().map(|r| r.1).chain([1.0]), [bottom, top]);
    let mut drawing = Drawing::new(SIZE);
    axes(&mut drawing, &errors, &speeds);
    for (row, speed) in &rows {
        let tracer = place(&tracers, &row.tracer);
        let mark = MARKS[place(&sets, &row.set) % MARKS.len()];
        let clean = row.tally.errors() == 0;
        // Side by side in the strip, so that none hides another.
        let share = (tracer as f32 + 0.5) / tracers.len() as f32;
        let x = if clean { left + STRIP * share } else { errors.at(row.error_rate) };
        drawing.mark([x, speeds.at(*speed)], mark, RADIUS, COLORS[tracer % COLORS.len()], !clean);
    }
    // The bound of those that were given all rays; the others' names say that they were given fewer.
    let most = rows.iter().map(|r| r.0.tally.rays).max().unwrap_or(0);
    let given_all = rows.iter().filter(|r| r.0.tally.errors() == 0 && 2 * r.0.tally.rays > most);
    let bound = given_all.map(|r| r.0.tally.bound()).fold(0.0, f64::max);
    titles(&mut drawing, machine, bound);
    legend(&mut drawing, &tracers, &sets);
    drawing
}

fn axes(drawing: &mut Drawing, errors: &Axis, speeds: &Axis) {
    let [left, right, top, bottom] = FRAME;
    errors.between().for_each(|x| drawing.line(&[[x, top], [x, bottom]], FINE, 1.0));
    speeds.between().for_each(|y| drawing.line(&[[left, y], [right, y]], FINE, 1.0));
    for (power, x) in errors.ticks() {
        drawing.line(&[[x, top], [x, bottom]], GRID, 1.0);
        let (text, exponent) = if power == 0 { ("1", String::new()) } else { ("10", power.to_string()) };
        drawing.text(Text { exponent, ..text_at([x, bottom + 20.0], text, Anchor::Middle) });
    }
    for (power, y) in speeds.ticks() {
        drawing.line(&[[left, y], [right, y]], GRID, 1.0);
        let decimals = usize::try_from(-power).unwrap_or(0);
        let text = format!("{:.decimals$}", 10f64.powi(power));
        drawing.text(text_at([left - 8.0, y + 4.5], &text, Anchor::End));
    }
    drawing.line(&[[left + STRIP, top], [left + STRIP, bottom]], AXIS, 1.2);
    drawing.line(&[[left, top], [left, bottom], [right, bottom]], AXIS, 1.2);
}

/// Titles of plot and axes; `bound`: where no error was seen there are, at 95 %, fewer than that.
fn titles(drawing: &mut Drawing, machine: &str, bound: f64) {
    let [left, right, top, bottom] = FRAME;
    drawing.text(Text { size: 17.0, ..text_at([left, top - 24.0], "Speed against error", Anchor::Start) });
    drawing.text(Text { size: 12.0, ..text_at([right, top - 24.0], machine, Anchor::End) });
    let middle = 0.5 * (left + STRIP + right);
    let what = "share of rays with a wrong answer: missed, false, or elsewhere";
    drawing.text(text_at([middle, bottom + 62.0], what, Anchor::Middle));
    let bound = if bound > 0.0 { format!("95 %: < {}", short(bound)) } else { String::new() };
    for (line, text) in [(20.0, "none found"), (37.0, &bound)] {
        let at = [left + 0.5 * STRIP - 4.0, bottom + line];
        drawing.text(Text { size: 12.0, ..text_at(at, text, Anchor::Middle) });
    }
    let speed = text_at([20.0, 0.5 * (top + bottom)], "million rays a second, one thread", Anchor::Middle);
    drawing.text(Text { upward: true, ..speed });
}

/// A small share with two figures: 0.00003.
fn short(share: f64) -> String {
    let decimals = (1.0 - share.log10().floor()).max(0.0) as usize;
    let text = format!("{share:.decimals$}");
    text.trim_end_matches('0').to_owned()
}

fn legend(drawing: &mut Drawing, tracers: &[&String], sets: &[&String]) {
    let mut y = FRAME[2] + 6.0;
    for (tracer, color) in tracers.iter().zip(COLORS.iter().cycle()) {
        drawing.mark([LEGEND, y - 4.5], Mark::Circle, RADIUS, *color, true);
        drawing.text(text_at([LEGEND + 16.0, y], tracer, Anchor::Start));
        y += 23.0;
    }
    y += 18.0;
    for (set, mark) in sets.iter().zip(MARKS.iter().cycle()) {
        drawing.mark([LEGEND, y - 4.5], *mark, RADIUS, AXIS, false);
        drawing.text(text_at([LEGEND + 16.0, y], set, Anchor::Start));
        y += 23.0;
    }
}

fn text_at(at: [f32; 2], text: &str, anchor: Anchor) -> Text {
    Text { at, text: text.to_owned(), exponent: String::new(), size: 14.0, anchor, upward: false }
}

fn each_once<'a>(names: impl Iterator<Item = &'a String>) -> Vec<&'a String> {
    let mut list = Vec::new();
    names.for_each(|name| {
        if !list.contains(&name) {
            list.push(name)
        }
    });
    list
}

fn place(list: &[&String], name: &String) -> usize {
    list.iter().position(|other| *other == name).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_take_in_their_values() {
        let axis = Axis::over([0.03, 4.0].into_iter(), [100.0, 400.0]);
        assert_eq!(axis.powers, [-2, 1]);
        assert_eq!((axis.at(0.01), axis.at(0.1), axis.at(10.0)), (100.0, 200.0, 400.0));
        assert!(axis.at(0.03) > 100.0 && axis.at(4.0) < 400.0);
        assert_eq!((axis.ticks().count(), axis.between().count()), (4, 24));
        assert_eq!([3e-5, 2.9e-5, 0.0015, 0.3].map(short), ["0.00003", "0.000029", "0.0015", "0.3"]);
    }
}
