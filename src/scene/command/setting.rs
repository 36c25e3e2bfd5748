//! Settings of the picture, and switches of the state.

use std::path::PathBuf;

use super::super::ToneMap;
use super::super::args::{Args, Limit};
use super::super::diagnose::{Problem, Step};
use super::super::parser::State;
use super::super::{MOST_DEPTH, MOST_PIXELS, MOST_SAMPLES, MOST_SIDE};

pub(super) fn output(state: &mut State, args: &mut Args) -> Step<()> {
    state.scene.output = Some(PathBuf::from(args.file()?.text));
    Ok(())
}

pub(super) fn outsize(state: &mut State, args: &mut Args) -> Step<()> {
    let [rows, columns] = size(["the number of rows", "the number of columns"], args)?;
    state.scene.size = [columns, rows];
    Ok(())
}

pub(super) fn resolution(state: &mut State, args: &mut Args) -> Step<()> {
    state.scene.size = size(["the width", "the height"], args)?;
    Ok(())
}

fn size(names: [&str; 2], args: &mut Args) -> Step<[u32; 2]> {
    let [a, b] = [args.integer(names[0], 1, MOST_SIDE)?, args.integer(names[1], 1, MOST_SIDE)?];
    if u64::from(a) * u64::from(b) > MOST_PIXELS {
        let message = format!("a picture has at most {MOST_PIXELS} pixels, not {}", u64::from(a) * u64::from(b));
        return Err(Problem::new(args.span_from(1), message));
    }
    Ok([a, b])
}

pub(super) fn background(state: &mut State, args: &mut Args) -> Step<()> {
    state.scene.background = args.rgb(&Limit::UNIT)?;
    Ok(())
}

pub(super) fn samples(state: &mut State, args: &mut Args) -> Step<()> {
    let samples = args.integer("the number of samples", 1, MOST_SAMPLES)?;
    let root = samples.isqrt();
    if root * root != samples {
        let problem = Problem::new(args.last_span(), "the number of samples must be a square: 1, 4, 9, 16, ...");
        return Err(problem.help(format!("the nearest are {} and {}", root * root, (root + 1) * (root + 1))));
    }
    state.scene.samples = samples;
    Ok(())
}

pub(super) fn depth(state: &mut State, args: &mut Args) -> Step<()> {
    state.scene.depth = args.integer("the number of bounces", 0, MOST_DEPTH)?;
    Ok(())
}

pub(super) fn mtl(state: &mut State, args: &mut Args) -> Step<()> {
    state.mtl = args.switch()?;
    Ok(())
}

pub(super) fn smooth(state: &mut State, args: &mut Args) -> Step<()> {
    state.smooth = args.switch()?;
    Ok(())
}

pub(super) fn tonemap(state: &mut State, args: &mut Args) -> Step<()> {
    state.scene.tonemap = match args.choice("`none` or `srgb`", &["none", "srgb"])? {
        "srgb" => ToneMap::Srgb,
        _ => ToneMap::None,
    };
    Ok(())
}
