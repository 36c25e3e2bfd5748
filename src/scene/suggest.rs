//! "Did you mean ...?": the name nearest to a mistyped one.

use strsim::damerau_levenshtein;

/// The candidate that `word` most likely stands for, if any is near: at most one letter in three is wrong (case does
/// not count), or one is the beginning of the other. Words longer than 64 bytes are nobody's typing error.
pub(super) fn nearest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    if word.is_empty() || word.len() > 64 {
        return None;
    }
    let word = word.to_lowercase();
    let letters = word.chars().count();
    let rank = |candidate: &str| -> Option<usize> {
        let candidate = candidate.to_lowercase();
        let distance = damerau_levenshtein(&word, &candidate);
        let near = distance <= (letters.max(candidate.chars().count()) / 3).max(1) && distance < letters;
        let begun =
            letters >= 3 && candidate.starts_with(&word) || candidate.len() >= 3 && word.starts_with(&candidate);
        (near || begun).then_some(distance)
    };
    // Of equally near ones the first in the alphabet, so that the answer does not depend on the order of a hash map.
    candidates.into_iter().filter_map(|c| rank(c).map(|r| (r, c))).min().map(|(_, c)| c)
}

/// The same as a sentence for a diagnostic.
pub(super) fn did_you_mean<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<String> {
    nearest(word, candidates).map(|name| format!("did you mean `{name}`?"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_names_are_found_and_far_ones_not() {
        let commands = ["rectangle", "rotate", "sphere", "color", "on", "off"];
        for (word, meant) in [
            ("rectange", Some("rectangle")),
            ("rect", Some("rectangle")),
            ("Sphere", Some("sphere")),
            ("colour", Some("color")),
            ("rotated", Some("rotate")),
            ("colors-of-all", Some("color")),
            ("of", Some("off")),
            ("camera", None),
            ("x", None),
            ("", None),
        ] {
            assert_eq!(nearest(word, commands), meant, "{word}");
        }
        assert_eq!(nearest(&"x".repeat(100_000), commands), None);
    }
}
