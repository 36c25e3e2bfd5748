//! Help, versions, man pages, completions, and what goes to pipes and to terminals.

use std::process::{Command, Stdio};

use super::support::*;

const TOOLS: [&str; 5] = ["octbuild", "octrender", "octtrace", "octinfo", "octbench"];

fn text(bytes: Vec<u8>) -> String {
    String::from_utf8(bytes).unwrap()
}

/// Whether a program is there; says so if not.
fn there(program: &str) -> bool {
    let found = Command::new(program).arg("--version").stdin(Stdio::null()).output().is_ok();
    if !found {
        println!("skipped: {program} is not installed");
    }
    found
}

/// Long options that a help text names at the beginnings of lines.
fn options(help: &str) -> Vec<String> {
    let name = |line: &str| {
        let at = line.trim_start().strip_prefix("--").or_else(|| line.trim_start().get(4..)?.strip_prefix("--"))?;
        let end = at.find(|c: char| !c.is_ascii_alphanumeric() && c != '-').unwrap_or(at.len());
        Some(format!("--{}", &at[..end]))
    };
    help.lines().filter(|line| line.trim_start().starts_with('-')).filter_map(name).collect()
}

#[test]
fn help_is_short_or_long() {
    let lab = Lab::new();
    for tool in TOOLS {
        let (short, long) = (text(lab.done(tool, &["-h"])), text(lab.done(tool, &["--help"])));
        assert!(short.lines().count() < long.lines().count(), "{tool}");
        assert!(short.contains(&format!("{tool} --help")) && !short.contains("Exit status"), "{short}");
        for title in ["Usage:", "General:", "Examples:", "Environment:", "Exit status:"] {
            assert!(long.lines().any(|line| line.starts_with(title)), "{tool}: {title} is missing in\n{long}");
        }
        for code in ["0    done", "1  ", "2  ", "3    an octree file", "4  ", "130  interrupted"] {
            assert!(long.contains(&format!("\n  {code}")), "{tool}: {code}");
        }
        // No line of the parts of our own is broken by clap, which would end its indentation.
        let own = &long[long.find("\nExamples:").unwrap()..];
        assert!(own.lines().all(|line| line.is_empty() || line.starts_with("  ") || line.ends_with(':')), "{own}");
        assert!(options(&long).contains(&"--generate".to_owned()) && !short.contains("--generate"), "{tool}");
    }
}

#[test]
fn versions() {
    let lab = Lab::new();
    let version = env!("CARGO_PKG_VERSION");
    for tool in TOOLS {
        assert_eq!(text(lab.done(tool, &["-V"])), format!("{tool} {version}\n"));
        let long = text(lab.done(tool, &["--version"]));
        let format = octrace::format::VERSION;
        assert!(
            long.starts_with(&format!("{tool} {version} (octree format {format}; instruction sets: scalar")),
            "{long}"
        );
        assert!(long.ends_with(&format!("in use: {})\n", octrace::trace::Isa::best().name())), "{long}");
    }
}

#[test]
fn man_pages_have_all_that_help_has() {
    let lab = Lab::new();
    let groff = there("groff");
    let mandoc = there("mandoc");
    for tool in TOOLS {
        let page = text(lab.done(tool, &["--generate", "man"]));
        let plain = page.replace("\\-", "-").replace("\\fB", "").replace("\\fR", "");
        for title in
            ["NAME", "SYNOPSIS", "DESCRIPTION", "OPTIONS", "ENVIRONMENT", "\"EXIT STATUS\"", "EXAMPLES", "\"SEE ALSO\""]
        {
            assert!(plain.lines().any(|line| line == format!(".SH {title}")), "{tool}: {title} is missing in\n{page}");
        }
        let help = text(lab.done(tool, &["--help"]));
        for option in options(&help) {
            assert!(plain.contains(&option), "{tool}: {option} is missing in\n{page}");
        }
        for other in TOOLS {
            assert_eq!(plain.contains(&format!("{other}(1)")), other != tool, "{tool}: {other}");
        }
        lab.write("page.1", &page);
        if groff {
            let mut command = Command::new("groff");
            command.args(["-man", "-ww", "-z", "-Tutf8", "-rLL=80n", "page.1"]).current_dir(lab.path(""));
            let output = command.output().unwrap();
            assert!(output.status.success() && output.stderr.is_empty(), "{tool}: {}", told(&output));
        }
        if mandoc {
            let output = Command::new("mandoc").args(["-Tlint", "-Werror"]).arg(lab.path("page.1")).output().unwrap();
            assert!(output.status.success(), "{tool}: {}", String::from_utf8_lossy(&output.stdout));
        }
    }
}

#[test]
fn the_man_page_of_octbench_has_its_commands() {
    let lab = Lab::new();
    let page = text(lab.done("octbench", &["--generate", "man"])).replace("\\-", "-");
    for command in ["accuracy", "replay", "closed", "mirrors", "speed", "figures", "tradeoff", "mesh"] {
        assert!(page.contains(&format!(".SS \"octbench {command} ")), "{command} is missing in\n{page}");
        let help = text(lab.done("octbench", &[command, "--help"]));
        for option in options(&help) {
            assert!(page.contains(&option), "{command} {option}");
        }
    }
}

#[test]
fn bash_takes_its_completions() {
    if !there("bash") {
        return;
    }
    let lab = Lab::new();
    for tool in TOOLS {
        lab.write(tool, lab.done(tool, &["--generate", "bash"]));
        let script = format!(
            "set -e; source ./{tool}; complete -p {tool} >/dev/null; COMP_WORDS=({tool} --qui); COMP_CWORD=1; \
             _{tool} {tool} --qui {tool}; echo \"${{COMPREPLY[*]}}\""
        );
        let output = Command::new("bash").args(["--norc", "-c", &script]).current_dir(lab.path("")).output().unwrap();
        assert_eq!((told(&output).as_str(), text(output.stdout).trim()), ("", "--quiet"), "{tool}");
    }
}

#[test]
fn other_shells_take_theirs() {
    let lab = Lab::new();
    let checks: [(&str, &[&str], &str); 3] = [
        ("zsh", &["-n"], "#compdef octrender"),
        ("fish", &["--no-execute"], "complete -c octrender -l size"),
        ("powershell", &[], "Register-ArgumentCompleter -Native -CommandName 'octrender'"),
    ];
    for (shell, check, expected) in checks {
        let page = text(lab.done("octrender", &["--generate", shell]));
        assert!(page.contains(expected) && page.contains("size"), "{shell}:\n{page}");
        lab.write("page", &page);
        if !check.is_empty() && there(shell) {
            let output = Command::new(shell).args(check).arg(lab.path("page")).output().unwrap();
            assert!(output.status.success() && output.stderr.is_empty(), "{shell}: {}", told(&output));
        }
    }
}

#[test]
fn pages_are_asked_for_alone() {
    let lab = Lab::with_ball();
    lab.fails(2, "octinfo", &["ball.oct", "--generate", "man"]);
    lab.fails(2, "octinfo", &["--generate", "man", "--json"]);
    let error = lab.fails(2, "octinfo", &["--generate", "mna"]);
    assert!(error.contains("similar") && error.contains("man"), "{error}");
    lab.fails(2, "octbench", &[]);
    lab.fails(2, "octbench", &["--quiet"]);
}

/// Runs with colours neither forbidden nor forced; what was written to both outputs.
fn written(lab: &Lab, tool: &str, args: &[&str], force: bool) -> Vec<u8> {
    let mut command = lab.command(tool, args);
    command.env_remove("NO_COLOR").env_remove("CLICOLOR").env("TERM", "xterm-256color");
    if force {
        command.env("CLICOLOR_FORCE", "1");
    }
    let output = command.output().unwrap();
    [output.stdout, output.stderr].concat()
}

#[test]
fn no_colour_codes_go_to_pipes() {
    let lab = Lab::with_ball();
    lab.write("bad.txt", "resolutoin 8 8\n");
    let runs: [(&str, &[&str]); 6] = [
        ("octrender", &["--help"]),
        ("octrender", &["--version"]),
        ("octrender", &["--szie"]),
        ("octrender", &["bad.txt"]),
        ("octbuild", &["ball.obj", "-o", "new.oct"]),
        ("octrender", &["ball.oct", "-o", "a.png", "--size", "300x300", "--samples", "16"]),
    ];
    for (tool, args) in runs {
        let bytes = written(&lab, tool, args, false);
        assert!(!bytes.is_empty() && !bytes.contains(&0x1b) && !bytes.contains(&b'\r'), "{tool} {args:?}");
    }
    for args in [&["--help"][..], &["bad.txt"]] {
        assert!(written(&lab, "octrender", args, true).contains(&0x1b), "CLICOLOR_FORCE: {args:?}");
    }
}

/// On a terminal there are a bar and colours, with `NO_COLOR` no colours. `script` (util-linux) is the terminal.
#[cfg(target_os = "linux")]
#[test]
fn bars_and_colours_go_to_terminals() {
    if !there("script") {
        return;
    }
    let lab = Lab::with_ball();
    lab.write("bad.txt", "resolutoin 8 8\n");
    let on_terminal = |line: &str, no_color: Option<&str>| {
        let mut command = Command::new("script");
        let line = format!("{} {line}", tool_path("octrender").display());
        command.args(["-q", "-e", "-c", &line, "/dev/null"]).current_dir(lab.path("")).stdin(Stdio::null());
        command.env_remove("NO_COLOR").env_remove("CLICOLOR_FORCE").env("TERM", "xterm-256color");
        if let Some(value) = no_color {
            command.env("NO_COLOR", value);
        }
        text(command.output().unwrap().stdout)
    };
    let colours = |text: &str| text.contains("\x1b[1m") || text.contains("\x1b[31") || text.contains("\x1b[1;");
    assert!(colours(&on_terminal("bad.txt", None)));
    assert!(!colours(&on_terminal("bad.txt", Some("1"))));
    assert!(!colours(&on_terminal("--help", Some("1"))));
    let draw = "ball.oct -o a.png --size 600x600 --samples 64";
    let drawn = on_terminal(draw, Some("1"));
    assert!(drawn.contains("left") && drawn.contains('\r'), "{drawn:?}");
    let quiet = on_terminal(&format!("{draw} -q"), None);
    assert!(quiet.is_empty(), "{quiet:?}");
}
