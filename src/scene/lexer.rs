//! Cuts one line into words: split on white space, `#` to the end is a comment, double quotes keep a name whole.
//!
//! There are no escapes: a name in quotes ends at the next quote, so that `\` in a path is just itself.

use std::ops::Range;

use super::diagnose::{Problem, Step};

/// A word of a line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Word<'a> {
    /// What it says, without quotes.
    pub text: &'a str,
    /// Where it stands in the line, in bytes, quotes included.
    pub span: Range<usize>,
    /// Whether it stood in quotes.
    pub quoted: bool,
}

/// The words of `line`; none for a blank line or a mere comment.
pub(super) fn words(line: &str) -> Step<Vec<Word<'_>>> {
    let mut words = Vec::new();
    let mut at = 0;
    loop {
        at += line[at..].len() - line[at..].trim_start().len();
        let rest = &line[at..];
        if rest.is_empty() || rest.starts_with('#') {
            return Ok(words);
        }
        let word = if rest.starts_with('"') { quoted(line, at)? } else { bare(line, at) };
        at = word.span.end;
        words.push(word);
    }
}

/// The word that starts at `start` and ends before white space or a comment.
fn bare(line: &str, start: usize) -> Word<'_> {
    let rest = &line[start..];
    let length = rest.find(|c: char| c.is_whitespace() || c == '#').unwrap_or(rest.len());
    Word { text: &rest[..length], span: start..start + length, quoted: false }
}

/// The word whose opening quote is at `start`.
fn quoted(line: &str, start: usize) -> Step<Word<'_>> {
    let inside = &line[start + 1..];
    let Some(length) = inside.find('"') else {
        let end = start + line[start..].trim_end().len();
        return Err(Problem::new(start..end, "this quote is not closed").help("end the name with `\"`"));
    };
    let span = start..start + length + 2;
    let next = line[span.end..].chars().next();
    if next.is_some_and(|c| !c.is_whitespace() && c != '#') {
        let end = bare(line, span.end).span.end;
        return Err(Problem::new(start..end, "a quoted name runs into the next word")
            .help("put a space after the closing quote"));
    }
    Ok(Word { text: &inside[..length], span, quoted: true })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(line: &str) -> Vec<&str> {
        words(line).unwrap().iter().map(|w| w.text).collect()
    }

    #[test]
    fn splits_on_white_space_of_any_kind() {
        assert_eq!(texts("  sphere\t0  -1 2.5\r"), ["sphere", "0", "-1", "2.5"]);
        assert_eq!(texts("a\u{a0}b\u{3000}c"), ["a", "b", "c"]);
        assert!(texts("").is_empty());
        assert!(texts(" \t\r").is_empty());
    }

    #[test]
    fn comments_start_anywhere_but_in_quotes() {
        assert!(texts("# all of it").is_empty());
        assert_eq!(texts("mat load blue #eol comment"), ["mat", "load", "blue"]);
        assert_eq!(texts("mat load blue#glued"), ["mat", "load", "blue"]);
        assert_eq!(texts("obj \"no. #1.obj\"# yes"), ["obj", "no. #1.obj"]);
    }

    #[test]
    fn quotes_keep_spaces_and_spans_include_them() {
        let line = "obj \"my mesh.obj\" \"\"";
        let words = words(line).unwrap();
        assert_eq!((words[1].text, &line[words[1].span.clone()]), ("my mesh.obj", "\"my mesh.obj\""));
        assert!(words[1].quoted && !words[0].quoted);
        assert_eq!((words[2].text, words[2].span.clone()), ("", 18..20));
    }

    #[test]
    fn bad_quotes_are_problems() {
        assert_eq!(words("obj \"a b  ").unwrap_err().span, 4..8);
        assert_eq!(words("obj \"a\"b c").unwrap_err().span, 4..8);
    }
}
