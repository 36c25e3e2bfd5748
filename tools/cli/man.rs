//! Man pages: the options as clap_mangen sets them, and around them the sections that a reader of man pages looks for.

use clap::Command;
use clap_mangen::Man;
use clap_mangen::roff::{Roff, bold, roman};

use super::manual::{Manual, Section, others};

/// The order of sections behind the options; others stand before them.
const ORDER: [&str; 4] = ["Environment", "Exit status", "Files", "Examples"];

/// What roff begins with, so that apostrophes stay what they are.
const PREAMBLE: &str = ".ie \\n(.g .ds Aq \\(aq\n.el .ds Aq '\n";

/// The man page of a tool, in roff.
pub fn page(command: Command, manual: &Manual) -> String {
    let name = command.get_name().to_owned();
    let man = Man::new(command.clone()).source(concat!("octrace ", env!("CARGO_PKG_VERSION"))).manual("octrace");
    let mut page = Roff::new();
    page.control("SH", ["DESCRIPTION"]);
    page.text([roman(sentence(&command))]);
    page.control("PP", []);
    for line in &manual.notes {
        match line.is_empty() {
            true => page.control("PP", []),
            false => page.text([roman(line)]),
        };
    }
    let mut text = PREAMBLE.to_owned()
        + &rendered(|to| man.render_title(to))
        + &rendered(|to| man.render_name_section(to))
        + &rendered(|to| man.render_synopsis_section(to))
        + &plain(&page)
        + &options(&man);
    if command.has_subcommands() {
        text += ".SH COMMANDS\n";
        text += &subcommands(command);
    }
    let mut sections: Vec<&Section> = manual.sections.iter().collect();
    sections.sort_by_key(|section| ORDER.iter().position(|&title| title == section.title).map_or(0, |place| place + 1));
    for section in sections {
        text += &list(&section.title.to_uppercase(), &section.items);
    }
    let others: Vec<String> = others(&name).map(|other| format!("{other}(1)")).collect();
    let mut also = Roff::new();
    also.control("SH", ["SEE ALSO"]);
    also.text([roman(others.join(", "))]);
    text + &plain(&also)
}

/// What a command does.
fn sentence(command: &Command) -> String {
    command.get_about().map(|about| format!("{about}.")).unwrap_or_default()
}

/// The options, those under a heading as a part of that section.
fn options(man: &Man) -> String {
    let text = rendered(|to| man.render_options_section(to));
    let mut out = String::with_capacity(text.len());
    for line in text.lines() {
        match line.strip_prefix(".SH ").filter(|&title| title != "OPTIONS") {
            Some(title) => {
                let title = title.trim_matches('"').to_lowercase();
                let (first, rest) = title.split_at(title.chars().next().map_or(0, char::len_utf8));
                out += &format!(".SS \"{}{rest}\"", first.to_uppercase());
            }
            None => out += line,
        }
        out.push('\n');
    }
    out
}

/// Each command with what it takes, without what all take.
fn subcommands(mut command: Command) -> String {
    command.build();
    let mut text = String::new();
    for sub in command.get_subcommands().filter(|sub| sub.get_name() != "help") {
        let own = sub.clone().mut_args(|arg| {
            let everywhere = arg.is_global_set() || ["help", "version"].contains(&arg.get_id().as_str());
            arg.hide(everywhere)
        });
        let usage = own.clone().render_usage().to_string();
        let mut head = Roff::new();
        head.control("SS", [usage.trim_start_matches("Usage: ")]);
        head.text([roman(sentence(&own))]);
        text += &plain(&head);
        let manual = Manual::read(&own.get_after_help().map(ToString::to_string).unwrap_or_default());
        text += &rendered(|to| Man::new(own).render_options_section(to))
            .lines()
            .filter(|line| !line.starts_with(".SH "))
            .fold(String::new(), |text, line| text + line + "\n");
        for Section { title, items } in manual.sections {
            let mut title_line = Roff::new();
            title_line.control("PP", []);
            title_line.text([roman(format!("{title}:"))]);
            text += &plain(&title_line);
            text += &terms(&items);
        }
    }
    text
}

/// A section that is a list.
fn list(title: &str, items: &[[String; 2]]) -> String {
    let mut head = Roff::new();
    head.control("SH", [title]);
    plain(&head) + &terms(items)
}

/// Terms, each with what it is.
fn terms(items: &[[String; 2]]) -> String {
    let mut list = Roff::new();
    for [term, what] in items {
        list.control("TP", []);
        list.text([bold(term)]);
        if !what.is_empty() {
            list.text([roman(what)]);
        }
    }
    plain(&list)
}

/// Roff without a preamble of its own.
fn plain(roff: &Roff) -> String {
    rendered(|to| roff.to_writer(to))
}

/// What is written, without a preamble.
fn rendered(write: impl FnOnce(&mut dyn std::io::Write) -> std::io::Result<()>) -> String {
    let mut bytes = Vec::new();
    // Writing to memory does not fail.
    let _ = write(&mut bytes);
    let text = String::from_utf8_lossy(&bytes);
    text.strip_prefix(PREAMBLE).unwrap_or(&text).to_owned()
}
