//! Problems at words, the places where they are, and the log that collects them.

use std::ops::Range;
use std::rc::Rc;

use crate::error::{Diagnostic, Error, Severity};
use crate::event::{Event, Monitor};

/// A line of more bytes than this is told only in part.
const LONGEST_TEXT: usize = 240;

/// Errors told before the reading is given up.
const MOST_ERRORS: usize = 1000;

/// Something wrong at a word of the line that is being read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Problem {
    /// What is wrong, one sentence without a full stop.
    pub message: String,
    /// Byte range of the word in the line.
    pub span: Range<usize>,
    /// What to do about it.
    pub help: Option<String>,
}

/// What a command gives back.
pub(super) type Step<T> = Result<T, Problem>;

impl Problem {
    pub fn new(span: Range<usize>, message: impl Into<String>) -> Self {
        Problem { message: message.into(), span, help: None }
    }

    pub fn help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(help.into());
        self
    }

    /// Help that is better than what there is, if any.
    pub fn maybe_help(mut self, help: Option<String>) -> Self {
        self.help = help.or(self.help);
        self
    }
}

/// A word for use in a message: in back quotes, shortened, nothing in it that could upset a terminal.
pub(super) fn quote(word: &str) -> String {
    let mut short: String = clean(word).chars().take(40).collect();
    if word.chars().nth(40).is_some() {
        short.push('…');
    }
    format!("`{short}`")
}

/// `text` with control characters (but tabs) replaced by others of the same length in UTF-8.
fn clean(text: &str) -> String {
    let visible = |c: char| match c {
        '\t' => c,
        c if c.is_ascii_control() => '?',
        c if c.is_control() => '·', // U+0080 to U+009F, two bytes like this one
        c => c,
    };
    text.chars().map(visible).collect()
}

/// The line that is being read.
#[derive(Clone, Copy)]
pub(super) struct Line<'a> {
    /// The file's name as the user knows it.
    pub file: &'a Rc<str>,
    /// Its number from 1.
    pub number: u64,
    /// The line without its newline.
    pub text: &'a str,
}

impl Line<'_> {
    /// Tells of `problem` at this line.
    pub fn diagnostic(&self, severity: Severity, problem: Problem) -> Diagnostic {
        let Problem { message, span, help } = problem;
        let column = self.text[..span.start].chars().count() as u64 + 1;
        let (text, span) = shorten(self.text, span);
        Diagnostic { severity, message, file: self.file.to_string(), line: self.number, column, text, span, help }
    }

    /// Remembers a word of this line for later.
    pub fn place(&self, span: Range<usize>) -> Place {
        Place { file: self.file.clone(), number: self.number, text: self.text.into(), span }
    }
}

/// A word of a line read earlier.
#[derive(Clone, Debug)]
pub(super) struct Place {
    file: Rc<str>,
    number: u64,
    text: Box<str>,
    span: Range<usize>,
}

impl Place {
    /// Tells of something wrong there.
    pub fn diagnostic(&self, severity: Severity, message: impl Into<String>, help: impl Into<String>) -> Diagnostic {
        let line = Line { file: &self.file, number: self.number, text: &self.text };
        line.diagnostic(severity, Problem::new(self.span.clone(), message).help(help))
    }

    /// "line 3", with the file if it is not `file`.
    pub fn describe(&self, file: &str) -> String {
        if *self.file == *file {
            format!("line {}", self.number)
        } else {
            format!("{}, line {}", self.file, self.number)
        }
    }
}

/// The part of a long line around `span`, and the span in it.
fn shorten(text: &str, span: Range<usize>) -> (String, Range<usize>) {
    if text.len() <= LONGEST_TEXT {
        return (clean(text), span);
    }
    let start = boundary(text, span.start.saturating_sub(LONGEST_TEXT / 4));
    let end = boundary(text, start.saturating_add(LONGEST_TEXT)).max(start);
    let (before, after) = (if start > 0 { "…" } else { "" }, if end < text.len() { "…" } else { "" });
    let shift = |at: usize| at.min(end) - start + before.len();
    (format!("{before}{}{after}", clean(&text[start..end])), shift(span.start)..shift(span.end))
}

/// The last boundary between characters that is not after `at`.
fn boundary(text: &str, at: usize) -> usize {
    (0..=at.min(text.len())).rev().find(|at| text.is_char_boundary(*at)).unwrap_or(0)
}

/// Collects errors and passes warnings on.
pub(super) struct Log<'a> {
    /// Errors become warnings.
    pub lenient: bool,
    /// Where warnings go.
    pub monitor: Monitor<'a>,
    errors: Vec<Diagnostic>,
}

impl<'a> Log<'a> {
    pub fn new(lenient: bool, monitor: Monitor<'a>) -> Self {
        Log { lenient, monitor, errors: Vec::new() }
    }

    /// Takes a remark; gives up when there have been too many errors.
    pub fn tell(&mut self, mut diagnostic: Diagnostic) -> Result<(), Error> {
        if self.lenient {
            diagnostic.severity = Severity::Warning;
        }
        match diagnostic.severity {
            Severity::Warning => self.monitor.send(Event::Diagnostic(diagnostic)),
            Severity::Error if self.errors.len() == MOST_ERRORS => {
                diagnostic.message = format!("more than {MOST_ERRORS} errors; nothing after this line has been read");
                diagnostic.help = Some("mend these first".to_owned());
                return Err(self.fatal(diagnostic));
            }
            Severity::Error => self.errors.push(diagnostic),
        }
        Ok(())
    }

    /// All errors, `diagnostic` the last of them.
    pub fn fatal(&mut self, diagnostic: Diagnostic) -> Error {
        self.errors.push(diagnostic);
        Error::Text(std::mem::take(&mut self.errors))
    }

    /// Fails if there have been errors.
    pub fn finish(self) -> Result<(), Error> {
        if self.errors.is_empty() { Ok(()) } else { Err(Error::Text(self.errors)) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_lines_keep_the_marked_word() {
        let text = format!("{}wrong{}", "é ".repeat(400), " word".repeat(400));
        let start = text.find("wrong").unwrap();
        let (short, span) = shorten(&text, start..start + 5);
        assert_eq!(&short[span], "wrong");
        assert!(short.len() <= LONGEST_TEXT + 6 && short.starts_with('…') && short.ends_with('…'));
    }

    #[test]
    fn a_marked_word_longer_than_the_text_is_cut() {
        let text = "x".repeat(10_000);
        let (short, span) = shorten(&text, 0..10_000);
        assert_eq!((short.len(), span), (LONGEST_TEXT + 3, 0..LONGEST_TEXT));
    }

    #[test]
    fn control_characters_do_not_reach_the_terminal() {
        let (text, span) = shorten("a\u{1b}[31m\u{9b}b", 6..8);
        assert_eq!((text.as_str(), &text[span]), ("a?[31m·b", "·"));
        assert_eq!(quote(&"y".repeat(50)), format!("`{}…`", "y".repeat(40)));
    }

    #[test]
    fn columns_count_characters() {
        let file: Rc<str> = "f".into();
        let line = Line { file: &file, number: 7, text: "äö wrong" };
        let told = line.diagnostic(Severity::Error, Problem::new(5..10, "m"));
        assert_eq!((told.line, told.column, &told.text[told.span]), (7, 4, "wrong"));
    }
}
