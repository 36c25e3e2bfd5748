//! Errors and warnings as the user sees them: the line, a caret under the word, and what to do.
//!
//! Colours appear only on a terminal that wants them (`NO_COLOR` is respected), which anstream decides.

use annotate_snippets::{AnnotationKind, Group, Level, Origin, Renderer, Snippet};
use octrace::{Diagnostic, Error, Severity};

/// Prints an error that ends the program.
pub fn print_error(error: &Error) {
    match error {
        Error::Text(diagnostics) => {
            let texts: Vec<String> = diagnostics.iter().map(render).collect();
            anstream::eprintln!("{}", texts.join("\n\n"));
        }
        other => anstream::eprintln!("{}", render_message(Severity::Error, &other.to_string())),
    }
}

/// A remark without a place in a text file, ready to be printed.
pub fn render_message(severity: Severity, message: &str) -> String {
    renderer().render(&[Group::with_title(level(severity).primary_title(message))])
}

/// A remark about a place in a text file, ready to be printed: message, place, line, caret, help.
pub fn render(d: &Diagnostic) -> String {
    let origin = Origin::path(d.file.as_str()).line(d.line as usize).char_column(d.column as usize);
    let title = level(d.severity).primary_title(d.message.as_str());
    let mut group = title.element(origin);
    // A tab is as wide as the terminal likes; as a space the caret stands under its word.
    let text = d.text.replace(['\t', '\r'], " ");
    if !text.trim().is_empty() {
        let caret = AnnotationKind::Primary.span(within(&text, &d.span));
        group = group.element(Snippet::source(text).line_start(d.line as usize).fold(false).annotation(caret));
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
        insta::assert_snapshot!(plain(&diagnostic("v 1 abc 3", 4..7)), @"");
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
