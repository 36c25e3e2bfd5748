//! The plot as SVG, by hand: error to the right, speed upward, both by powers of ten.

use super::Row;

const WIDTH: f64 = 800.0;
const HEIGHT: f64 = 500.0;
/// Left, right, top, bottom.
const MARGIN: [f64; 4] = [70.0, 190.0, 50.0, 60.0];
const ERRORS: [i32; 2] = [-7, 0];
const SPEEDS: [i32; 2] = [-4, 2];

fn x(error: f64) -> f64 {
    let [low, high] = ERRORS.map(f64::from);
    let share = (error.log10().clamp(low, high) - low) / (high - low);
    MARGIN[0] + share * (WIDTH - MARGIN[0] - MARGIN[1])
}

fn y(speed: f64) -> f64 {
    let [low, high] = SPEEDS.map(f64::from);
    let share = (speed.log10().clamp(low, high) - low) / (high - low);
    HEIGHT - MARGIN[3] - share * (HEIGHT - MARGIN[2] - MARGIN[3])
}

/// The plot.
pub fn svg(rows: &[Row]) -> String {
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" font-family=\"sans-serif\" \
         font-size=\"13\">\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n<text x=\"{}\" y=\"28\" \
         font-size=\"17\">Speed against error, rays aimed at vertices, edges and faces</text>\n",
        MARGIN[0]
    );
    let (left, right, top, bottom) = (x(1e-7), x(1.0), y(1e2), y(1e-4));
    for power in ERRORS[0]..=ERRORS[1] {
        let at = x(10f64.powi(power));
        text += &format!(
            "<path d=\"M{at:.1} {top:.1}V{bottom:.1}\" stroke=\"#ddd\"/><text x=\"{at:.1}\" y=\"{:.1}\" \
             text-anchor=\"middle\">10<tspan dy=\"-5\" font-size=\"10\">{power}</tspan></text>\n",
            bottom + 20.0
        );
    }
    for power in SPEEDS[0]..=SPEEDS[1] {
        let at = y(10f64.powi(power));
        text += &format!(
            "<path d=\"M{left:.1} {at:.1}H{right:.1}\" stroke=\"#ddd\"/><text x=\"{:.1}\" y=\"{:.1}\" \
             text-anchor=\"end\">10<tspan dy=\"-5\" font-size=\"10\">{power}</tspan></text>\n",
            left - 8.0,
            at + 4.0
        );
    }
    text += &format!(
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">share of wrong rays (hollow: none found, 95 % bound)</text>\n\
         <text transform=\"translate(20 {:.1}) rotate(-90)\" text-anchor=\"middle\">million rays a second</text>\n",
        0.5 * (left + right),
        bottom + 45.0,
        0.5 * (top + bottom)
    );
    for (row, (name, speed, error)) in rows.iter().filter_map(|r| Some((r, r.point()?))) {
        let (at, up) = (x(error), y(speed));
        let fill = if row.is_clean() { "#fff" } else { "#c33" };
        let edge = if row.is_clean() { "#186" } else { "#c33" };
        text += &format!(
            "<circle cx=\"{at:.1}\" cy=\"{up:.1}\" r=\"6\" fill=\"{fill}\" stroke=\"{edge}\" stroke-width=\"2\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\">{name}</text>\n",
            at + 11.0,
            up + 4.0
        );
    }
    text + "</svg>\n"
}
