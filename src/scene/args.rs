//! The words of one command, taken one after another as numbers, points, names and switches.

use std::ops::Range;

use glam::DVec3;

use super::diagnose::{Line, Place, Problem, Step, quote};
use super::lexer::Word;
use super::suggest::did_you_mean;

/// A range that a number must lie in, and how to say so.
pub(super) struct Limit {
    holds: fn(f64) -> bool,
    says: &'static str,
}

impl Limit {
    /// Any number that an f32 can hold.
    pub const ANY: Limit = Limit { holds: |_| true, says: "" };
    /// A colour's channel where light above 1 makes no sense.
    pub const UNIT: Limit = Limit { holds: |x| (0.0..=1.0).contains(&x), says: "between 0 and 1" };
    /// Weights, intensities, colours.
    pub const NOT_NEGATIVE: Limit = Limit { holds: |x| x >= 0.0, says: "0 or more" };
    /// Radii, indices of refraction.
    pub const POSITIVE: Limit = Limit { holds: |x| x > 0.0, says: "greater than 0" };
    /// Scales.
    pub const NOT_ZERO: Limit = Limit { holds: |x| x != 0.0, says: "other than 0" };
    /// A field of view in degrees.
    pub const ANGLE: Limit = Limit { holds: |x| x > 0.0 && x < 180.0, says: "between 0 and 180, both excluded" };
}

/// The words of the command that is being read.
pub(super) struct Args<'a> {
    /// The line.
    pub line: Line<'a>,
    /// The command's own word, or with its sub-command ("mat save").
    command: String,
    usage: &'static str,
    words: &'a [Word<'a>],
    next: usize,
    /// Warnings to be told after the command.
    pub warnings: Vec<Problem>,
}

impl<'a> Args<'a> {
    /// `words`, the first of which is the command; `usage` as in the table of commands.
    pub fn new(line: Line<'a>, words: &'a [Word<'a>], usage: &'static str) -> Self {
        Args { line, command: words[0].text.to_string(), usage, words, next: 1, warnings: Vec::new() }
    }

    /// Where the command's word stands.
    pub fn command_span(&self) -> Range<usize> {
        self.words[0].span.clone()
    }

    /// Where the word taken last stands.
    pub fn last_span(&self) -> Range<usize> {
        self.words[self.next - 1].span.clone()
    }

    /// From word `first` (0 is the command) to the word taken last.
    pub fn span_from(&self, first: usize) -> Range<usize> {
        self.words[first.min(self.next - 1)].span.start..self.last_span().end
    }

    /// Remembers where the command stands.
    pub fn place(&self) -> Place {
        self.line.place(self.command_span())
    }

    /// Words not yet taken.
    pub fn left(&self) -> usize {
        self.words.len() - self.next
    }

    /// The next word, not yet taken.
    pub fn peek(&self) -> Option<&'a Word<'a>> {
        self.words.get(self.next)
    }

    /// Whether the next word looks like a number.
    pub fn number_is_next(&self) -> bool {
        self.peek().is_some_and(|word| is_number(word))
    }

    /// Warns at `span`, should the command succeed.
    pub fn warn(&mut self, span: Range<usize>, message: impl Into<String>, help: impl Into<String>) {
        self.warnings.push(Problem::new(span, message).help(help));
    }

    /// Warns of words that no one has taken.
    pub fn warn_of_rest(&mut self) {
        let Some(first) = self.peek() else { return };
        let count = self.left();
        let span = first.span.start..self.words[self.words.len() - 1].span.end;
        let takes_name = ["FILE", "NAME"].iter().any(|name| self.usage.contains(name));
        let help = match takes_name && !is_number(first) {
            true => format!("usage: `{}`; a name with spaces stands in double quotes", self.usage),
            false => format!("usage: `{}`", self.usage),
        };
        let words = if count == 1 { "a superfluous word".to_string() } else { format!("{count} superfluous words") };
        self.warn(span, format!("{words} after `{}`", self.command), help);
    }

    /// The next word, whatever it is.
    pub fn word(&mut self, what: &str) -> Step<&'a Word<'a>> {
        let Some(word) = self.words.get(self.next) else {
            return Err(Problem::new(
                self.command_span(),
                format!("`{}` ends too early: {what} is missing", self.command),
            )
            .help(format!("usage: `{}`", self.usage)));
        };
        self.next += 1;
        Ok(word)
    }

    /// The next word as a sub-command: from now on messages name it too, with its own usage.
    pub fn subcommand(&mut self, what: &str, choices: &[(&'static str, &'static str)]) -> Step<&'static str> {
        let names: Vec<_> = choices.iter().map(|(name, _)| *name).collect();
        let chosen = self.choice(what, &names)?;
        self.command = format!("{} {chosen}", self.command);
        self.usage = choices.iter().find(|(name, _)| *name == chosen).map_or(self.usage, |(_, usage)| usage);
        Ok(chosen)
    }

    /// The next word as one of `choices`.
    pub fn choice(&mut self, what: &str, choices: &[&'static str]) -> Step<&'static str> {
        let word = self.word(what)?;
        if let Some(chosen) = choices.iter().find(|choice| **choice == word.text) {
            return Ok(chosen);
        }
        let all = choices.iter().map(|choice| format!("`{choice}`")).collect::<Vec<_>>().join(", ");
        let problem = Problem::new(word.span.clone(), format!("{} is not one of {all}", quote(word.text)));
        let usage = format!("usage: `{}`", self.usage);
        Err(problem.help(did_you_mean(word.text, choices.iter().copied()).unwrap_or(usage)))
    }

    /// The next word as `on` or `off`.
    pub fn switch(&mut self) -> Step<bool> {
        Ok(self.choice("`on` or `off`", &["on", "off"])? == "on")
    }

    /// The next word as the name of a file.
    pub fn file(&mut self) -> Step<&'a Word<'a>> {
        let word = self.word("the name of a file")?;
        match word.text.contains('\0') || word.text.is_empty() {
            true => Err(Problem::new(word.span.clone(), "this is no name of a file")),
            false => Ok(word),
        }
    }

    /// The next word as a number within `limit`.
    pub fn number(&mut self, what: &str, limit: &Limit) -> Step<f64> {
        let word = self.word(what)?;
        let value = parse_number(word, what)?;
        if !(limit.holds)(value) {
            return Err(Problem::new(word.span.clone(), format!("{what} must be {}", limit.says)));
        }
        Ok(value)
    }

    /// The next word as a whole number from `least` to `most`.
    pub fn integer(&mut self, what: &str, least: u32, most: u32) -> Step<u32> {
        let word = self.word(what)?;
        let value = parse_number(word, what)?;
        if value.fract() != 0.0 || value < f64::from(least) || value > f64::from(most) {
            let message = format!("{what} must be a whole number from {least} to {most}");
            return Err(Problem::new(word.span.clone(), message));
        }
        Ok(value as u32)
    }

    /// The next three words as numbers.
    pub fn vector(&mut self, what: &str) -> Step<DVec3> {
        self.three(what, ["x", "y", "z"], &Limit::ANY)
    }

    /// The next three words as a vector that is not zero, brought to unit length.
    pub fn direction(&mut self, what: &str) -> Step<DVec3> {
        let first = self.next;
        let direction = self.vector(what)?;
        if direction == DVec3::ZERO {
            return Err(Problem::new(self.span_from(first), format!("{what} must not be zero")));
        }
        Ok(unit(direction))
    }

    /// The next three words as red, green and blue.
    pub fn rgb(&mut self, limit: &Limit) -> Step<DVec3> {
        self.three("the colour", ["red", "green", "blue"], limit)
    }

    fn three(&mut self, what: &str, parts: [&str; 3], limit: &Limit) -> Step<DVec3> {
        let mut part = |name| self.number(&format!("{name} of {what}"), limit);
        Ok(DVec3::new(part(parts[0])?, part(parts[1])?, part(parts[2])?))
    }
}

/// `v` at unit length; zero stays zero. Squares of its components neither overflow nor vanish.
pub(super) fn unit(v: DVec3) -> DVec3 {
    (v / v.abs().max_element()).normalize_or_zero()
}

/// Whether a word is meant as a number (which may still be out of range).
pub(super) fn is_number(word: &Word<'_>) -> bool {
    // "inf" and "nan" parse, too, but nobody means them.
    !word.quoted && word.text.contains(|c: char| c.is_ascii_digit()) && word.text.parse::<f64>().is_ok()
}

/// A finite number that f32 can hold: rays are f32, so nothing beyond could be seen.
fn parse_number(word: &Word<'_>, what: &str) -> Step<f64> {
    let problem = |message| Problem::new(word.span.clone(), message);
    let Ok(value) = word.text.parse::<f64>() else {
        let comma = word.text.contains(',') && word.text.replace(',', "").parse::<f64>().is_ok();
        let help = comma.then(|| "numbers have a decimal point and are separated by spaces".to_string());
        return Err(problem(format!("{what} must be a number, not {}", quote(word.text))).maybe_help(help));
    };
    if !value.is_finite() && !is_number(word) {
        return Err(problem(format!("{what} must be a finite number, not {}", quote(word.text))));
    }
    if value.abs() > f64::from(f32::MAX) {
        return Err(problem(format!("{what} is too large: numbers go up to 3.4e38")));
    }
    Ok(value)
}
