//! From a place in a block's text to a [`Diagnostic`]: line, column, and the line as it can be shown.

use std::ops::Range;

use memchr::{memchr, memchr_iter, memrchr};

use super::parse::Problem;
use crate::error::{Diagnostic, Severity};

/// What to do about a mistake where there is nothing better to say.
pub(super) const SKIP: &str = "correct the line, or give --lenient to skip what is wrong";
/// Bytes of a line's text that are shown before and after the marked word, if the line is longer than three of these.
const AROUND: usize = 80;

/// Says where in the file a problem of a block lies; `first_line` is the number of the block's first line.
pub(super) fn diagnose(problem: Problem, text: &[u8], file: String, first_line: u64, severity: Severity) -> Diagnostic {
    let Problem { place, message, help } = problem;
    let before = &text[..place.start];
    let start = memrchr(b'\n', before).map_or(0, |newline| newline + 1);
    let end = memchr(b'\n', &text[place.start..]).map_or(text.len(), |n| place.start + n);
    let line = text[start..end].strip_suffix(b"\r").unwrap_or(&text[start..end]);
    let place = place.start - start..(place.end - start).min(line.len());
    let (shown, span) = excerpt(line, place.clone());
    Diagnostic {
        severity,
        message,
        file,
        line: first_line + memchr_iter(b'\n', before).count() as u64,
        column: decode(&line[..place.start]).chars().count() as u64 + 1,
        text: shown,
        span,
        // What is only told of was skipped already.
        help: help.or_else(|| (severity == Severity::Error).then(|| SKIP.to_owned())),
    }
}

/// The line, shortened to the surroundings of `place` if it is long, and where `place` lies in it.
fn excerpt(line: &[u8], place: Range<usize>) -> (String, Range<usize>) {
    if line.len() <= 3 * AROUND {
        return join("", &line[..place.start], &line[place.clone()], &line[place.end..], "");
    }
    let is_middle_of_char = |&at: &usize| line.get(at).is_some_and(|byte| byte & 0xc0 == 0x80);
    let border = |from: usize, to: usize| (from..to).find(|at| !is_middle_of_char(at)).unwrap_or(to);
    let from = border(place.start.saturating_sub(AROUND), place.start);
    let stop = border(place.end.min(place.start + AROUND), place.end);
    let to = border((stop + AROUND).min(line.len()), line.len());
    let (front, back) = (if from > 0 { "..." } else { "" }, if to < line.len() { "..." } else { "" });
    join(front, &line[from..place.start], &line[place.start..stop], &line[stop..to], back)
}

fn join(front: &str, before: &[u8], marked: &[u8], after: &[u8], back: &str) -> (String, Range<usize>) {
    let (before, marked, after) = (decode(before), decode(marked), decode(after));
    let start = front.len() + before.len();
    let span = start..start + marked.len();
    (format!("{front}{before}{marked}{after}{back}"), span)
}

/// Text of unknown coding: UTF-8 if it can be, else Latin-1, in which every byte is a character.
pub(super) fn decode(bytes: &[u8]) -> String {
    match std::str::from_utf8(bytes) {
        Ok(text) => text.to_owned(),
        Err(_) => bytes.iter().map(|&byte| byte as char).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(text: &[u8], place: Range<usize>) -> Diagnostic {
        let problem = Problem { place, message: "wrong".into(), help: None };
        diagnose(problem, text, "a.obj".into(), 10, Severity::Error)
    }

    #[test]
    fn lines_and_columns_count_from_one_in_characters() {
        let found = at("v 1 2 3\r\nv é x 3\r\n".as_bytes(), 14..15);
        assert_eq!((found.line, found.column, &found.text[..]), (11, 5, "v é x 3"));
        assert_eq!(&found.text[found.span], "x");
        let found = at(b"v \xe9 x", 4..5);
        assert_eq!((found.line, found.column, &found.text[..]), (10, 5, "v é x"));
        assert_eq!(&found.text[found.span], "x");
    }

    #[test]
    fn long_lines_are_shortened_around_the_word() {
        let text = format!("{}x {}", "é ".repeat(1000), "1 ".repeat(1000));
        let found = at(text.as_bytes(), 3000..3001);
        assert_eq!(found.column, 2001);
        assert!(found.text.len() < 200 && found.text.starts_with("...") && found.text.ends_with("..."));
        assert_eq!(&found.text[found.span], "x");
        let found = at("é".repeat(5000).as_bytes(), 0..10_000);
        assert!(found.text.len() < 200 && found.span.start == 0);
    }
}
