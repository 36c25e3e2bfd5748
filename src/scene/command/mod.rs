//! The commands of the language, one function each: it takes its words, checks them, and only then changes the state,
//! so that a command with an error has no effect.

mod camera;
mod light;
mod material;
mod mesh;
mod setting;
mod shape;
mod transform;

pub(super) use camera::CameraWish;

use super::args::Args;
use super::diagnose::Step;
use super::parser::State;

/// A command of the language.
pub(super) struct Command {
    /// Its word.
    pub name: &'static str,
    /// Its words, as told to the user.
    pub usage: &'static str,
    /// What it does.
    pub run: fn(&mut State, &mut Args) -> Step<()>,
}

const fn command(name: &'static str, usage: &'static str, run: fn(&mut State, &mut Args) -> Step<()>) -> Command {
    Command { name, usage, run }
}

/// All commands, in the order of the alphabet.
pub(super) static COMMANDS: &[Command] = &[
    command("amblight", "amblight INTENSITY", light::amblight),
    command("background", "background R G B", setting::background),
    command("color", "color NAME R G B", material::color),
    command("depth", "depth BOUNCES", setting::depth),
    command("eye", "eye X Y Z", camera::eye),
    command("fov", "fov DEGREES", camera::fov),
    command("frame", "frame [DX DY DZ]", camera::frame),
    command("horiz", "horiz X Y Z", camera::horiz),
    command("include", "include FILE", mesh::include),
    command("light", "light X Y Z INTENSITY [R G B]", light::light),
    command("local", "local WEIGHT", material::local),
    command("lookat", "lookat EYE(3) AT(3) UP(3)", camera::lookat),
    command("mat", "mat amb|diff|spec|save|load ...", material::mat),
    command("mtl", "mtl on|off", setting::mtl),
    command("obj", "obj FILE", mesh::obj),
    command("oct", "oct [off|FILE]", mesh::oct),
    command("origin", "origin X Y Z", camera::origin),
    command("output", "output FILE", setting::output),
    command("outsize", "outsize ROWS COLUMNS", setting::outsize),
    command("plane", "plane POINT(3) NORMAL(3)", shape::plane),
    command("pop", "pop", transform::pop),
    command("push", "push", transform::push),
    command("rectangle", "rectangle LOWER-LEFT(3) LOWER-RIGHT(3) UPPER-RIGHT(3)", shape::rectangle),
    command("reflect", "reflect WEIGHT", material::reflect),
    command("resolution", "resolution WIDTH HEIGHT", setting::resolution),
    command("rotate", "rotate DEGREES AXIS(3)", transform::rotate),
    command("samples", "samples N", setting::samples),
    command("scale", "scale S, or scale X Y Z", transform::scale),
    command("shininess", "shininess EXPONENT", material::shininess),
    command("smooth", "smooth on|off", setting::smooth),
    command("sphere", "sphere CX CY CZ RADIUS", shape::sphere),
    command("sun", "sun DX DY DZ INTENSITY [R G B]", light::sun),
    command("tonemap", "tonemap none|srgb", setting::tonemap),
    command("translate", "translate X Y Z", transform::translate),
    command("transmit", "transmit WEIGHT INDEX", material::transmit),
    command("triangle", "triangle A(3) B(3) C(3)", shape::triangle),
    command("vert", "vert X Y Z", camera::vert),
];

/// The command of that name.
pub(super) fn find(name: &str) -> Option<&'static Command> {
    COMMANDS.binary_search_by(|command| command.name.cmp(name)).ok().map(|at| &COMMANDS[at])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_is_found_by_its_name() {
        for command in COMMANDS {
            assert_eq!(find(command.name).unwrap().usage, command.usage);
            assert!(command.usage.starts_with(command.name));
        }
        assert!(find("Sphere").is_none() && find("").is_none());
    }
}
