//! Text that is nearly right: lines of whole files, cut, doubled, crossed, and with tokens that break things.

use super::random::Random;

/// Numbers that break things.
pub const NUMBERS: [&str; 25] = [
    "0",
    "-0",
    "1",
    "-1",
    "2147483647",
    "2147483648",
    "-2147483649",
    "4294967295",
    "4294967296",
    "9223372036854775807",
    "18446744073709551616",
    "1e38",
    "3.5e38",
    "1e-46",
    "1e999",
    "-1e999",
    "nan",
    "inf",
    "0x10",
    "1/2/3",
    "1//3",
    "-1/-1/-1",
    "1/",
    "1e",
    ".",
];
const GLUE: [&str; 12] = ["\\\n", "\r\n", "\r", "\t", "\0", "#", "\"", "\\", "\u{feff}", "\u{e4}", " ", "\n"];

/// Changes a text in one to ten places, mostly few; `words` are such as mean something in it.
pub fn mutate(text: &mut Vec<u8>, words: &[&str], random: &mut Random) {
    let most = 1 + random.below(10);
    for _ in 0..1 + random.below(most) {
        let lines: Vec<(usize, usize)> = lines(text);
        let (first, end) = *random.one_of(&lines);
        match random.below(10) {
            0 => {
                let at = random.below(text.len() + 1);
                insert(text, at, random.one_of(&GLUE).as_bytes());
            }
            1 => {
                let at = random.below(text.len() + 1);
                insert(text, at, &[random.bits() as u8]);
            }
            2 if !text.is_empty() => {
                let at = random.below(text.len());
                text[at] ^= 1 << random.below(8);
            }
            3 => {
                text.drain(first..end);
            }
            4 => {
                let line = text[first..end].to_vec();
                let (at, _) = *random.one_of(&lines);
                for _ in 0..1 + random.below(3) * random.below(20) {
                    insert(text, at, &line);
                }
            }
            5 => {
                let cut = random.below(text.len() + 1);
                text.truncate(cut);
            }
            6 | 7 => replace_word(text, first, end, NUMBERS[random.below(NUMBERS.len())], random),
            8 => replace_word(text, first, end, words[random.below(words.len())], random),
            _ => {
                let line: String = (0..1 + random.below(8))
                    .map(|i| if i == 0 || random.once_in(4) { *random.one_of(words) } else { *random.one_of(&NUMBERS) })
                    .flat_map(|word| [word, " "])
                    .collect();
                insert(text, first, format!("{line}\n").as_bytes());
            }
        }
    }
}

/// Begin and end of each line, its newline included; one empty line if there is none.
fn lines(text: &[u8]) -> Vec<(usize, usize)> {
    let mut lines = Vec::new();
    let mut first = 0;
    for line in text.split_inclusive(|b| *b == b'\n') {
        lines.push((first, first + line.len()));
        first += line.len();
    }
    if lines.is_empty() {
        lines.push((0, 0));
    }
    lines
}

fn insert(text: &mut Vec<u8>, at: usize, what: &[u8]) {
    text.splice(at..at, what.iter().copied());
}

fn replace_word(text: &mut Vec<u8>, first: usize, end: usize, word: &str, random: &mut Random) {
    let line = &text[first..end];
    let mut words = Vec::new();
    let mut at = 0;
    for piece in line.split_inclusive(|b| b.is_ascii_whitespace()) {
        words.push((first + at, first + at + piece.trim_ascii_end().len()));
        at += piece.len();
    }
    if words.is_empty() {
        return;
    }
    let (from, to) = *random.one_of(&words);
    text.splice(from..to, word.bytes());
}
