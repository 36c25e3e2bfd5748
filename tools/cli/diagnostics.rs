//! Errors and warnings as the user sees them: the line, a caret under the word, and what to do.
//!
//! Colours appear only on a terminal that wants them (`NO_COLOR` is respected), which anstream decides.

use std::io::Write;

use annotate_snippets::{AnnotationKind, Group, Level, Origin, Renderer, Snippet};
use octrace::{Diagnostic, Error, Severity};

/// Prints an error that ends the program.
pub fn print_error(error: &Error) {
    match error {
        Error::Text(diagnostics) => {
            let texts: Vec<String> = diagnostics.iter().map(render).collect();
            say(&texts.join("\n\n"));
        }
        other => say(&render_message(Severity::Error, &other.to_string())),
    }
}

/// Prints a line on standard error. That nobody reads it any more is no reason to stop.
pub fn say(line: &str) {
    let _ = writeln!(anstream::stderr(), "{line}");
}

/// A remark without a place in a text file, ready to be printed.
pub fn render_message(severity: Severity, message: &str) -> String {
    renderer().render(&[Group::with_title(level(severity).primary_title(message))])
}

/// A remark about a place in a text file, ready to be printed: message, place, line, caret, help.
pub fn render(d: &Diagnostic) -> String {
    let mut group = Group::with_title(level(d.severity).primary_title(d.message.as_str()));
    // A tab is as wide as the terminal likes; as a space the caret stands under its word.
    let text = d.text.replace(['\t', '\r'], " ");
    let span = within(&text, &d.span);
    // The renderer counts the column in the text it is given, which is wrong for a line that was shortened.
    let counts = text[..span.start].chars().count() as u64 + 1 == d.column;
    if !counts || text.trim().is_empty() {
        let (line, column) = (d.line as usize, d.column as usize);
        group = group.element(Origin::path(d.file.as_str()).line(line).char_column(column));
    }
    if !text.trim().is_empty() {
        let snippet = Snippet::source(text).line_start(d.line as usize).fold(false);
        let snippet = if counts { snippet.path(d.file.as_str()) } else { snippet };
        group = group.element(snippet.annotation(AnnotationKind::Primary.span(span)));
    }
    if let Some(help) = &d.help {
        group = group.element(Level::HELP.message(help.as_str()));
    }
    renderer().render(&[group])
}

/// Styled: anstream takes the colours out where they are not wanted.
fn renderer() -> Renderer {
    Renderer::styled()
}

fn level(severity: Severity) -> Level<'static> {
    match severity {
        Severity::Error => Level::ERROR,
        Severity::Warning => Level::WARNING,
    }
}

/// The span cut to the text and to whole characters.
fn within(text: &str, span: &std::ops::Range<usize>) -> std::ops::Range<usize> {
    let whole = |mut at: usize| {
        at = at.min(text.len());
        while !text.is_char_boundary(at) {
            at -= 1;
        }
        at
    };
    let start = whole(span.start);
    start..whole(span.end).max(start)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(d: &Diagnostic) -> String {
        anstream::adapter::strip_str(&render(d)).to_string()
    }

    fn diagnostic(text: &str, span: std::ops::Range<usize>) -> Diagnostic {
        Diagnostic {
            severity: Severity::Error,
            message: "not a number".into(),
            file: "a.obj".into(),
            line: 12,
            column: span.start as u64 + 1,
            text: text.into(),
            span,
            help: Some("write a number".into()),
        }
    }

    #[test]
    fn caret_stands_under_the_word() {
        let expected = "\
error: not a number
  --> a.obj:12:5
   |
12 | v 1 abc 3
   |     ^^^
   |
   = help: write a number";
        assert_eq!(plain(&diagnostic("v 1 abc 3", 4..7)), expected);
    }

    #[test]
    fn a_shortened_line_keeps_its_column() {
        let shortened = Diagnostic { column: 4711, ..diagnostic("... abc ...", 4..7) };
        assert!(plain(&shortened).contains("a.obj:12:4711"), "{}", plain(&shortened));
    }

    #[test]
    fn odd_spans_do_not_panic() {
        for (text, span) in
            [("", 0..0), ("äöü", 1..2), ("abc", 2..99), ("abc", 50..60), ("a\tb\r", 2..3), ("   ", 1..2)]
        {
            assert!(plain(&diagnostic(text, span)).contains("a.obj:12:"));
        }
    }
}
