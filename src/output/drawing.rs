//! A drawing: lines, marks and text, written as SVG or PNG from the same list of shapes.
//!
//! Lengths are in pixels of the SVG, y downward; the PNG has [`SCALE`] times as many. SVG leaves the text to the reader's sans-serif
//! font; PNG uses Ubuntu Light, which comes with the program, so that it looks the same on every machine.

use std::fmt::Write as _;

use image::RgbImage;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use tiny_skia::{Color, FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Stroke, Transform};
use ttf_parser::{Face, GlyphId, OutlineBuilder};

use crate::error::{Error, Result};

/// Pixels of the PNG for one of the SVG.
pub const SCALE: f32 = 2.0;
/// How high a raised exponent stands above the line, in parts of the font's size.
const RAISED: f32 = 0.4;
/// The size of an exponent, in parts of the font's size.
const SMALL: f32 = 0.72;

/// Red, green, blue.
pub type Rgb = [u8; 3];

/// The shape of a mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// A circle.
    Circle,
    /// A square.
    Square,
    /// A triangle that stands on its side.
    Triangle,
    /// A square on its corner.
    Diamond,
}

/// Where a text's given point lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// At its beginning.
    Start,
    /// In its middle.
    Middle,
    /// At its end.
    End,
}

/// A piece of text.
#[derive(Clone, Debug)]
pub struct Text {
    /// Its given point, on the base line.
    pub at: [f32; 2],
    /// What it says.
    pub text: String,
    /// Raised behind it, smaller.
    pub exponent: String,
    /// Font size.
    pub size: f32,
    /// Where the point lies.
    pub anchor: Anchor,
    /// Read from below upward.
    pub upward: bool,
}

enum Shape {
    Line { points: Vec<[f32; 2]>, color: Rgb, width: f32 },
    Area { corners: [[f32; 2]; 2], color: Rgb },
    Mark { at: [f32; 2], mark: Mark, radius: f32, color: Rgb, filled: bool },
    Text(Text),
}

/// Shapes on white.
pub struct Drawing {
    size: [f32; 2],
    shapes: Vec<Shape>,
}

impl Drawing {
    /// An empty drawing.
    pub fn new(size: [f32; 2]) -> Drawing {
        Drawing { size, shapes: vec![] }
    }

    /// A line through points.
    pub fn line(&mut self, points: &[[f32; 2]], color: Rgb, width: f32) {
        self.shapes.push(Shape::Line { points: points.to_vec(), color, width });
    }

    /// A filled rectangle between two opposite corners.
    pub fn area(&mut self, corners: [[f32; 2]; 2], color: Rgb) {
        self.shapes.push(Shape::Area { corners, color });
    }

    /// A mark, filled or hollow.
    pub fn mark(&mut self, at: [f32; 2], mark: Mark, radius: f32, color: Rgb, filled: bool) {
        self.shapes.push(Shape::Mark { at, mark, radius, color, filled });
    }

    /// A text.
    pub fn text(&mut self, text: Text) {
        self.shapes.push(Shape::Text(text));
    }

    /// As SVG.
    pub fn svg(&self) -> String {
        let [width, height] = self.size;
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" \
             font-family=\"sans-serif\" fill=\"#222\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n"
        );
        for shape in &self.shapes {
            match shape {
                Shape::Line { points, color, width } => {
                    let color = hex(*color);
                    let _ = writeln!(
                        svg,
                        "<path d=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"{width}\"/>",
                        path_data(points)
                    );
                }
                Shape::Area { corners, color } => {
                    let _ = writeln!(svg, "<path d=\"{}Z\" fill=\"{}\"/>", path_data(&outline(*corners)), hex(*color));
                }
                Shape::Mark { at, mark, radius, color, filled } => {
                    let color = hex(*color);
                    let fill = if *filled { &color } else { "#fff" };
                    let style = format!("fill=\"{fill}\" stroke=\"{color}\" stroke-width=\"{MARK_EDGE}\"");
                    let [x, y] = at;
                    let _ = match mark {
                        Mark::Circle => writeln!(svg, "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{radius}\" {style}/>"),
                        _ => writeln!(svg, "<path d=\"{}Z\" {style}/>", path_data(&corners(*mark, *at, *radius))),
                    };
                }
                Shape::Text(text) => svg += &text.svg(),
            }
        }
        svg + "</svg>\n"
    }

    /// As PNG.
    ///
    /// Fails only where memory does not suffice to encode it.
    pub fn png(&self) -> Result<Vec<u8>> {
        let failed = |e| Error::Option(format!("cannot write the plot as PNG: {e}"));
        let mut png = Vec::new();
        let encoder = PngEncoder::new_with_quality(&mut png, CompressionType::Best, FilterType::Adaptive);
        self.picture().write_with_encoder(encoder).map_err(failed)?;
        Ok(png)
    }

    /// As pixels, [`SCALE`] of them for one of the drawing.
    pub fn picture(&self) -> RgbImage {
        let [width, height] = self.size.map(|x| ((x * SCALE).round() as u32).max(1));
        let mut pixels = Pixmap::new(width, height).expect("the drawing has a size");
        pixels.fill(Color::WHITE);
        let face = Face::parse(epaint_default_fonts::UBUNTU_LIGHT, 0).expect("the font is whole");
        for shape in &self.shapes {
            match shape {
                Shape::Line { points, color, width } => {
                    stroke(&mut pixels, polyline(points, false), *color, *width);
                }
                Shape::Area { corners, color } => fill(&mut pixels, polyline(&outline(*corners), true), *color),
                Shape::Mark { at, mark, radius, color, filled } => {
                    let path = match mark {
                        Mark::Circle => PathBuilder::from_circle(at[0], at[1], *radius),
                        _ => polyline(&corners(*mark, *at, *radius), true),
                    };
                    fill(&mut pixels, path.clone(), if *filled { *color } else { [255; 3] });
                    stroke(&mut pixels, path, *color, MARK_EDGE);
                }
                Shape::Text(text) => fill(&mut pixels, text.outline(&face), INK),
            }
        }
        let opaque = pixels.data().chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
        RgbImage::from_raw(width, height, opaque).expect("three bytes a pixel")
    }
}

/// Width of the line around a mark.
const MARK_EDGE: f32 = 1.8;
/// Colour of text.
const INK: Rgb = [0x22; 3];

impl Text {
    fn svg(&self) -> String {
        let [x, y] = self.at;
        let anchor = match self.anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let place = if self.upward {
            format!("transform=\"translate({x:.2} {y:.2}) rotate(-90)\"")
        } else {
            format!("x=\"{x:.2}\" y=\"{y:.2}\"")
        };
        let text = self.text.replace('&', "&amp;").replace('<', "&lt;");
        let exponent = match self.exponent.as_str() {
            "" => String::new(),
            e => format!("<tspan dy=\"{:.1}\" font-size=\"{:.1}\">{e}</tspan>", -RAISED * self.size, SMALL * self.size),
        };
        format!("<text {place} font-size=\"{}\" text-anchor=\"{anchor}\">{text}{exponent}</text>\n", self.size)
    }

    /// The letters' outlines, in place.
    fn outline(&self, face: &Face<'_>) -> Option<Path> {
        let (main, small) = (self.size, SMALL * self.size);
        let width = advance(face, &self.text, main) + advance(face, &self.exponent, small);
        let start = match self.anchor {
            Anchor::Start => 0.0,
            Anchor::Middle => -0.5 * width,
            Anchor::End => -width,
        };
        let mut pen = Pen { path: PathBuilder::new(), at: [start, 0.0], unit: 0.0 };
        pen.write(face, &self.text, main);
        pen.at[1] = -RAISED * self.size;
        pen.write(face, &self.exponent, small);
        let turn = Transform::from_rotate(if self.upward { -90.0 } else { 0.0 });
        pen.path.finish()?.transform(turn.post_translate(self.at[0], self.at[1]))
    }
}

/// Puts the outlines of letters side by side.
struct Pen {
    path: PathBuilder,
    at: [f32; 2],
    /// Pixels of a unit of the font.
    unit: f32,
}

impl Pen {
    fn write(&mut self, face: &Face<'_>, text: &str, size: f32) {
        self.unit = size / f32::from(face.units_per_em());
        for glyph in glyphs(face, text) {
            face.outline_glyph(glyph, self);
            self.at[0] += self.unit * f32::from(face.glyph_hor_advance(glyph).unwrap_or(0));
        }
    }

    fn place(&self, x: f32, y: f32) -> [f32; 2] {
        [self.at[0] + self.unit * x, self.at[1] - self.unit * y]
    }
}

impl OutlineBuilder for Pen {
    fn move_to(&mut self, x: f32, y: f32) {
        let [x, y] = self.place(x, y);
        self.path.move_to(x, y);
    }
    fn line_to(&mut self, x: f32, y: f32) {
        let [x, y] = self.place(x, y);
        self.path.line_to(x, y);
    }
    fn quad_to(&mut self, x1: f32, y1: f32, x: f32, y: f32) {
        let ([x1, y1], [x, y]) = (self.place(x1, y1), self.place(x, y));
        self.path.quad_to(x1, y1, x, y);
    }
    fn curve_to(&mut self, x1: f32, y1: f32, x2: f32, y2: f32, x: f32, y: f32) {
        let ([x1, y1], [x2, y2], [x, y]) = (self.place(x1, y1), self.place(x2, y2), self.place(x, y));
        self.path.cubic_to(x1, y1, x2, y2, x, y);
    }
    fn close(&mut self) {
        self.path.close();
    }
}

fn glyphs<'a>(face: &'a Face<'_>, text: &'a str) -> impl Iterator<Item = GlyphId> + 'a {
    text.chars().map(|c| face.glyph_index(c).unwrap_or_default())
}

/// Width of a text in the PNG's font.
fn advance(face: &Face<'_>, text: &str, size: f32) -> f32 {
    let units: f32 = glyphs(face, text).map(|g| f32::from(face.glyph_hor_advance(g).unwrap_or(0))).sum();
    units * size / f32::from(face.units_per_em())
}

/// The corners of a mark of straight edges.
fn corners(mark: Mark, [x, y]: [f32; 2], r: f32) -> Vec<[f32; 2]> {
    let s = 0.886 * r;
    match mark {
        Mark::Circle => vec![],
        Mark::Square => vec![[x - s, y - s], [x + s, y - s], [x + s, y + s], [x - s, y + s]],
        Mark::Triangle => vec![[x, y - 1.25 * r], [x + 1.15 * r, y + 0.75 * r], [x - 1.15 * r, y + 0.75 * r]],
        Mark::Diamond => vec![[x, y - 1.3 * r], [x + 1.3 * r, y], [x, y + 1.3 * r], [x - 1.3 * r, y]],
    }
}

/// All corners of a rectangle.
fn outline([[x0, y0], [x1, y1]]: [[f32; 2]; 2]) -> [[f32; 2]; 4] {
    [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
}

fn path_data(points: &[[f32; 2]]) -> String {
    let step = |(i, [x, y]): (usize, &[f32; 2])| format!("{}{x:.2} {y:.2}", if i == 0 { 'M' } else { 'L' });
    points.iter().enumerate().map(step).collect()
}

fn hex([r, g, b]: Rgb) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

fn polyline(points: &[[f32; 2]], closed: bool) -> Option<Path> {
    let mut path = PathBuilder::new();
    for (i, [x, y]) in points.iter().enumerate() {
        if i == 0 { path.move_to(*x, *y) } else { path.line_to(*x, *y) }
    }
    if closed {
        path.close();
    }
    path.finish()
}

fn paint([r, g, b]: Rgb) -> Paint<'static> {
    let mut paint = Paint::default();
    paint.set_color_rgba8(r, g, b, 255);
    paint
}

fn fill(pixels: &mut Pixmap, path: Option<Path>, color: Rgb) {
    if let Some(path) = path {
        pixels.fill_path(&path, &paint(color), FillRule::Winding, Transform::from_scale(SCALE, SCALE), None);
    }
}

fn stroke(pixels: &mut Pixmap, path: Option<Path>, color: Rgb, width: f32) {
    if let Some(path) = path {
        let stroke = Stroke { width, line_cap: LineCap::Butt, line_join: LineJoin::Miter, ..Stroke::default() };
        pixels.stroke_path(&path, &paint(color), &stroke, Transform::from_scale(SCALE, SCALE), None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Drawing {
        let mut drawing = Drawing::new([100.0, 60.0]);
        drawing.line(&[[0.0, 30.0], [100.0, 30.0]], [255, 0, 0], 4.0);
        drawing.area([[90.0, 5.0], [98.0, 20.0]], [9, 8, 7]);
        drawing.mark([20.0, 15.0], Mark::Square, 8.0, [0, 0, 255], true);
        drawing.mark([50.0, 15.0], Mark::Circle, 8.0, [0, 128, 0], false);
        let text = |text: &str, anchor, at| Text {
            at,
            text: text.into(),
            exponent: "-3".into(),
            size: 12.0,
            anchor,
            upward: false,
        };
        drawing.text(text("10 < & H", Anchor::End, [98.0, 52.0]));
        drawing
    }

    #[test]
    fn both_forms_show_the_shapes_where_they_are() {
        let drawing = sample();
        let svg = drawing.svg();
        assert!(svg.contains("10 &lt; &amp; H<tspan") && svg.contains("<circle") && svg.ends_with("</svg>\n"), "{svg}");
        let picture = image::load_from_memory(&drawing.png().unwrap()).unwrap().into_rgb8();
        assert_eq!(picture.dimensions(), (200, 120));
        let at = |x: f32, y: f32| picture.get_pixel((x * SCALE) as u32, (y * SCALE) as u32).0;
        assert_eq!(at(80.0, 30.0), [255, 0, 0]);
        assert_eq!((at(20.0, 15.0), at(94.0, 12.0)), ([0, 0, 255], [9, 8, 7]));
        // Hollow: white within, coloured at the edge.
        assert_eq!((at(50.0, 15.0), at(58.0, 15.0)), ([255; 3], [0, 128, 0]));
        let inked = |x0: u32, x1: u32| (x0..x1).any(|x| (76..118).any(|y| picture.get_pixel(x, y).0[0] < 100));
        // The text ends at its point, and begins no further left than its letters reach.
        assert!(inked(150, 196) && !inked(197, 200) && !inked(0, 60));
    }
}
