//! The manual: what `--help` says behind the options, man pages and completions, all from the one definition of the arguments.
//!
//! A tool's `after_help` is the source: notes, then sections such as `Examples:`, whose items are lines `  TERM   what it is` with two
//! spaces or more between; a line that is indented further goes on with the item. What holds for all tools is added here.
//! `-h` shows none of this; `--help` and the man page, which [`super::man`] sets, show all of it.

use std::ffi::OsString;
use std::fmt::Write as _;

use clap::builder::Styles;
use clap::{Arg, ArgMatches, Command, ValueEnum};
use octrace::trace::Isa;

/// All tools, in the order in which they are used.
const TOOLS: [&str; 5] = ["octbuild", "octrender", "octtrace", "octinfo", "octbench"];

/// What holds for all tools.
const COMMON: &str = "\
Environment:
  NO_COLOR           no colours, if it is set and not empty
  CLICOLOR_FORCE     colours also where no terminal is, if it is 1
  RAYON_NUM_THREADS  threads to work with where --threads does not say

Exit status:
  0    done
  1    a check was carried out and failed (octbench)
  2    wrong usage, or an input that is missing or wrong
  3    an octree file that is damaged
  4    the machine failed: disk full, permission denied, out of memory
  130  interrupted
";

/// What `--generate` prints.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Page {
    /// The man page, in roff
    Man,
    /// Completions for bash
    Bash,
    /// Completions for zsh
    Zsh,
    /// Completions for fish
    Fish,
    /// Completions for PowerShell
    Powershell,
}

/// What stands behind the options.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Manual {
    /// Lines of text.
    pub notes: Vec<String>,
    pub sections: Vec<Section>,
}

/// A list with a title.
#[derive(Debug, PartialEq, Eq)]
pub struct Section {
    pub title: String,
    /// Terms, each with what it is, which may be empty.
    pub items: Vec<[String; 2]>,
}

impl Manual {
    /// Reads the text of an `after_help`.
    pub fn read(text: &str) -> Manual {
        let mut manual = Manual::default();
        let mut lines = text.lines().peekable();
        while let Some(line) = lines.next() {
            let items_follow = lines.peek().is_some_and(|next| next.starts_with("  "));
            match (line.strip_suffix(':'), manual.sections.last_mut()) {
                (Some(title), _) if items_follow && !line.starts_with(' ') => {
                    manual.sections.push(Section { title: title.to_owned(), items: Vec::new() });
                }
                (_, None) => manual.notes.push(line.to_owned()),
                (_, Some(section)) => section.add(line),
            }
        }
        while manual.notes.last().is_some_and(String::is_empty) {
            manual.notes.pop();
        }
        manual
    }

    /// All that is told of a tool: its own notes and sections, and what holds for all.
    pub fn of(command: &Command) -> Manual {
        let mut manual = Manual::read(&command.get_after_help().map(ToString::to_string).unwrap_or_default());
        for common in Manual::read(COMMON).sections {
            match manual.sections.iter_mut().find(|own| own.title == common.title) {
                Some(own) => own.items.extend(common.items),
                None => manual.sections.push(common),
            }
        }
        manual
    }

    /// As `--help` shows it.
    fn help(&self) -> String {
        let (header, mut text) = (Styles::styled(), self.notes.join("\n"));
        let header = header.get_header();
        for section in &self.sections {
            let before = if text.is_empty() { "" } else { "\n\n" };
            let _ = write!(text, "{before}{header}{}:{header:#}", section.title);
            let width = section.items.iter().map(|[term, _]| term.chars().count()).max().unwrap_or(0);
            for [term, what] in &section.items {
                let _ = match (what.is_empty(), width <= 20) {
                    (true, _) => write!(text, "\n  {term}"),
                    (_, true) => write!(text, "\n  {term:width$}  {what}"),
                    (_, false) => write!(text, "\n  {term}\n      {what}"),
                };
            }
        }
        text
    }
}

impl Section {
    /// Adds an item, or a line to the last one.
    fn add(&mut self, line: &str) {
        let text = line.trim();
        match (line.strip_prefix("  ").filter(|rest| !rest.starts_with(' ')), self.items.last_mut()) {
            _ if text.is_empty() => {}
            (Some(item), _) => {
                let (term, what) = item.split_once("  ").unwrap_or((item, ""));
                self.items.push([term.trim().to_owned(), what.trim().to_owned()]);
            }
            (None, Some([_, what])) => {
                let space = if what.is_empty() { "" } else { " " };
                what.push_str(space);
                what.push_str(text);
            }
            (None, None) => self.items.push([text.to_owned(), String::new()]),
        }
    }
}

/// The tools beside this one.
pub fn others(name: &str) -> impl Iterator<Item = &'static str> {
    TOOLS.into_iter().filter(move |&other| other != name)
}

/// The definition of a tool's arguments with what holds for all tools.
pub fn complete(command: Command) -> Command {
    let brief = format!("Examples, exit codes and more: {} --help", command.get_name());
    let help = Manual::of(&command).help();
    let generate = Arg::new("generate")
        .long("generate")
        .value_name("WHAT")
        .help("Print the man page, or completions for a shell, and do nothing else")
        .help_heading("General")
        .value_parser(clap::value_parser!(Page))
        .hide_short_help(true)
        .exclusive(true);
    command
        .after_help(brief)
        .after_long_help(help)
        .version(env!("CARGO_PKG_VERSION"))
        .long_version(long_version())
        .propagate_version(true)
        .arg(generate)
}

/// The same as it parses these words: who asks for a page need not name a command.
pub fn parsing(command: Command, mut words: impl Iterator<Item = OsString>) -> Command {
    let asked = words.nth(1).is_some_and(|word| word.to_string_lossy().starts_with("--generate"));
    if asked { command.subcommand_required(false).arg_required_else_help(false) } else { command }
}

/// The page that was asked for.
pub fn wanted(matches: &ArgMatches) -> Option<Page> {
    matches.get_one("generate").copied()
}

/// A page of a tool, whose own definition of its arguments is given.
pub fn page(page: Page, command: Command) -> Vec<u8> {
    use clap_complete::Shell;
    let manual = Manual::of(&command);
    let (name, mut command, mut bytes) = (command.get_name().to_owned(), complete(command), Vec::new());
    let shell = match page {
        Page::Man => return super::man::page(command, &manual).into_bytes(),
        Page::Bash => Shell::Bash,
        Page::Zsh => Shell::Zsh,
        Page::Fish => Shell::Fish,
        Page::Powershell => Shell::PowerShell,
    };
    clap_complete::generate(shell, &mut command, name, &mut bytes);
    bytes
}

/// Program version, version of the file format, and the instruction sets that were compiled in and that this processor has.
fn long_version() -> String {
    let here = Isa::available().into_iter().map(Isa::name).collect::<Vec<_>>();
    let missing = Isa::COMPILED.iter().filter(|name| !here.contains(name)).copied().collect::<Vec<_>>();
    let missing = if missing.is_empty() { String::new() } else { format!(", not here: {}", missing.join(" ")) };
    format!(
        "{} (octree format {}; instruction sets: {}{missing}, in use: {})",
        env!("CARGO_PKG_VERSION"),
        octrace::format::VERSION,
        Isa::COMPILED.join(" "),
        Isa::best().name()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notes_and_sections_are_told_apart() {
        let manual = Manual::read(
            "A note: with a colon.\nAnother:\n\nExamples:\n  a -b c   what it does\n  d e\n           what that does,\n     and more\n\nFiles:\n  f\n",
        );
        assert_eq!(manual.notes, ["A note: with a colon.", "Another:"]);
        let section = |title: &str, items: &[[&str; 2]]| Section {
            title: title.into(),
            items: items.iter().map(|item| item.map(str::to_owned)).collect(),
        };
        let examples = [["a -b c", "what it does"], ["d e", "what that does, and more"]];
        assert_eq!(manual.sections, [section("Examples", &examples), section("Files", &[["f", ""]])]);
        assert_eq!(Manual::read(""), Manual::default());
    }

    #[test]
    fn what_a_tool_says_stands_before_what_all_say() {
        let manual = Manual::of(&Command::new("x").after_help("Environment:\n  OWN  its own\n"));
        let environment = &manual.sections[0];
        assert_eq!(environment.items[0][0], "OWN");
        assert_eq!(environment.items[1][0], "NO_COLOR");
        assert_eq!(manual.sections.len(), 2);
    }
}
