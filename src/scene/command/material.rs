//! Colours and the current material.

use super::super::Color;
use super::super::args::{Args, Limit, is_number};
use super::super::diagnose::{Problem, Step, quote};
use super::super::parser::State;
use super::super::suggest::did_you_mean;

pub(super) fn color(state: &mut State, args: &mut Args) -> Step<()> {
    let name = args.word("the colour's name")?;
    if is_number(name) {
        let message = format!("a colour's name must not be a number like {}", quote(name.text));
        return Err(Problem::new(name.span.clone(), message).help("usage: `color NAME R G B`"));
    }
    let color = args.rgb(&Limit::NOT_NEGATIVE)?;
    warn_if_bright(color, args, 2);
    state.colors.insert(name.text.to_string(), color);
    Ok(())
}

pub(super) fn mat(state: &mut State, args: &mut Args) -> Step<()> {
    let what = args.subcommand(
        "what to set, `amb`, `diff`, `spec`, `save` or `load`,",
        &[
            ("amb", "mat amb NAME, or mat amb R G B"),
            ("diff", "mat diff NAME, or mat diff R G B"),
            ("spec", "mat spec NAME, or mat spec R G B"),
            ("save", "mat save NAME"),
            ("load", "mat load NAME"),
        ],
    )?;
    match what {
        "amb" => state.material.ambient = named_color(state, args)?,
        "diff" => state.material.diffuse = named_color(state, args)?,
        "spec" => state.material.specular = named_color(state, args)?,
        "save" => drop(state.saved.insert(args.word("the material's name")?.text.to_string(), state.material)),
        _ => return load(state, args),
    }
    Ok(())
}

fn load(state: &mut State, args: &mut Args) -> Step<()> {
    let word = args.word("the material's name")?;
    let Some(material) = state.saved.get(word.text) else {
        let save = format!("`mat save {}` must come first", word.text);
        let message = format!("no material is called {}", quote(word.text));
        let near = did_you_mean(word.text, state.saved.keys().map(String::as_str));
        return Err(Problem::new(word.span.clone(), message).help(save).maybe_help(near));
    };
    state.material = *material;
    Ok(())
}

/// A colour by name, or three numbers.
fn named_color(state: &State, args: &mut Args) -> Step<Color> {
    if args.number_is_next() {
        let color = args.rgb(&Limit::NOT_NEGATIVE)?;
        warn_if_bright(color, args, 2);
        return Ok(color);
    }
    let word = args.word("a colour")?;
    state.colors.get(word.text).copied().ok_or_else(|| {
        let message = format!("no colour is called {}", quote(word.text));
        let kind = match state.saved.contains_key(word.text) {
            true => format!("{} is a material, to be recalled by `mat load`", quote(word.text)),
            false => "`color NAME R G B` must come first, or give three numbers".to_string(),
        };
        let near = did_you_mean(word.text, state.colors.keys().map(String::as_str));
        Problem::new(word.span.clone(), message).help(kind).maybe_help(near)
    })
}

/// Someone may think of colours from 0 to 255.
fn warn_if_bright(color: Color, args: &mut Args, first: usize) {
    if color.max_element() > 1.0 {
        let span = args.span_from(first);
        args.warn(span, "this colour gives back more light than it gets", "red, green and blue go from 0 to 1");
    }
}

fn weight(args: &mut Args) -> Step<f64> {
    let weight = args.number("the weight", &Limit::NOT_NEGATIVE)?;
    if weight > 1.0 {
        args.warn(args.last_span(), "this weight gives back more light than it gets", "weights go from 0 to 1");
    }
    Ok(weight)
}

pub(super) fn local(state: &mut State, args: &mut Args) -> Step<()> {
    state.material.local = weight(args)?;
    Ok(())
}

pub(super) fn reflect(state: &mut State, args: &mut Args) -> Step<()> {
    state.material.reflect = weight(args)?;
    Ok(())
}

/// Where the weight is 0, the index may be missing, and any number will do.
pub(super) fn transmit(state: &mut State, args: &mut Args) -> Step<()> {
    let weight = weight(args)?;
    let ior = if weight > 0.0 {
        args.number("the index of refraction", &Limit::POSITIVE)?
    } else {
        if args.left() > 0 {
            args.number("the index of refraction", &Limit::ANY)?;
        }
        1.0
    };
    (state.material.transmit, state.material.ior) = (weight, ior);
    Ok(())
}

pub(super) fn shininess(state: &mut State, args: &mut Args) -> Step<()> {
    state.material.shininess = args.number("the exponent", &Limit::NOT_NEGATIVE)?;
    Ok(())
}
