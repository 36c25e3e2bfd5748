//! Words of a logical line.
//!
//! Blanks are spaces, tabs and carriage returns. A backslash before a newline continues the line and counts as a blank;
//! `#` where a word would begin starts a comment, which runs to the newline and is not continued.

use std::ops::Range;

use memchr::memchr;

/// Walks over the words of the logical line that begins at `at`.
#[derive(Clone, Debug)]
pub(super) struct Words<'a> {
    text: &'a [u8],
    at: usize,
}

impl<'a> Words<'a> {
    /// The line at byte `at` of `text`, which ends with a newline.
    pub fn new(text: &'a [u8], at: usize) -> Self {
        Words { text, at }
    }

    /// Where the next word lies, if the line has one.
    #[inline]
    pub fn next_word(&mut self) -> Option<Range<usize>> {
        loop {
            match *self.text.get(self.at)? {
                byte if is_blank(byte) => self.at += 1,
                b'\n' => return None,
                b'#' => {
                    self.at = end_of_line(self.text, self.at);
                    return None;
                }
                b'\\' => match self.continuation() {
                    Some(next) => self.at = next,
                    None => break,
                },
                _ => break,
            }
        }
        let start = self.at;
        while let Some(&byte) = self.text.get(self.at) {
            if is_blank(byte) || byte == b'\n' || byte == b'\\' && self.continuation().is_some() {
                break;
            }
            self.at += 1;
        }
        Some(start..self.at)
    }

    /// Where the line goes on after a backslash here, if that ends the physical line.
    fn continuation(&self) -> Option<usize> {
        match self.text[self.at + 1..] {
            [b'\n', ..] => Some(self.at + 2),
            [b'\r', b'\n', ..] => Some(self.at + 3),
            _ => None,
        }
    }

    /// How many words are left; the walk ends there.
    pub fn count_rest(&mut self) -> u64 {
        std::iter::from_fn(|| self.next_word()).map(|_| 1).sum()
    }

    /// Passes over the rest of the line and returns where the next one begins.
    pub fn finish(&mut self) -> usize {
        self.count_rest();
        (self.at + 1).min(self.text.len())
    }

    /// Where the rest of the physical line lies, blanks around it cut off. Names are taken this way: they may contain
    /// blanks, `#` and backslashes. The walk ends there.
    pub fn rest(&mut self) -> Range<usize> {
        let end = end_of_line(self.text, self.at);
        let rest = &self.text[self.at..end];
        let front = rest.iter().take_while(|&&byte| is_blank(byte)).count();
        let back = rest[front..].iter().rev().take_while(|&&byte| is_blank(byte)).count();
        let range = self.at + front..end - back;
        self.at = end;
        range
    }
}

/// Whether a byte separates words within a line.
#[inline]
fn is_blank(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t' | b'\r' | 0x0b | 0x0c)
}

/// Where the newline at or after `at` lies.
fn end_of_line(text: &[u8], at: usize) -> usize {
    memchr(b'\n', &text[at..]).map_or(text.len(), |n| at + n)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(text: &str) -> (Vec<&str>, usize) {
        let mut walk = Words::new(text.as_bytes(), 0);
        let words = std::iter::from_fn(|| walk.next_word()).map(|range| &text[range]).collect();
        (words, walk.finish())
    }

    #[test]
    fn words_end_at_blanks_comments_and_newlines() {
        assert_eq!(words("  a\tb c#d # e\nf"), (vec!["a", "b", "c#d"], 14));
        assert_eq!(words("a\r\nb"), (vec!["a"], 3));
        assert_eq!(words("\n"), (vec![], 1));
        assert_eq!(words("# a \\\nb"), (vec![], 6));
    }

    #[test]
    fn a_backslash_before_the_newline_continues_the_line() {
        assert_eq!(words("a \\\n b\\\r\nc\nd"), (vec!["a", "b", "c"], 11));
        assert_eq!(words("a\\b \\\n"), (vec!["a\\b"], 6));
        assert_eq!(words("a \\"), (vec!["a", "\\"], 3));
    }

    #[test]
    fn names_keep_their_blanks() {
        let text = b"usemtl  red # 1 \\\r\nf";
        let mut walk = Words::new(text, 0);
        walk.next_word();
        assert_eq!(&text[walk.rest()], b"red # 1 \\");
        assert_eq!(walk.finish(), 19);
    }
}
