//! How a report is told: a table, Markdown.

use std::fmt::Write as _;

use super::{Cost, Mean, PeerRow, Report, Row, Set};

impl Report {
    /// As a table for people.
    pub fn table(&self) -> String {
        let p = &self.by_part;
        let mut t = format!(
            "{}: {} triangles, {:.2} bytes each (nodes {:.2}, leaf vertices {:.2}, leaf corners {:.2}, ids {:.2}, \
             attributes {:.2}, level of detail {:.2}, rest {:.2})\n{}; medians of {} rounds in turn{}\n",
            self.model,
            self.triangles,
            self.bytes_per_triangle,
            p.nodes,
            p.leaf_vertices,
            p.leaf_corners,
            p.ids,
            p.attributes,
            p.level_of_detail,
            p.rest,
            self.machine,
            self.rounds,
            self.clock.note()
        );
        for (number, peer) in self.peers.iter().enumerate() {
            let _ = writeln!(t, "[{}] = {peer}", number + 1);
        }
        let width = self.first_column();
        for set in &self.sets {
            let _ = write!(
                t,
                "\n{:width$} {:>8} {:>9} | {:>6} {:>6} {:>9} {:>6} {:>7}",
                set.title(),
                "Mrays/s",
                "hit",
                "nodes",
                "leaves",
                "triangles",
                "pages",
                "doubts"
            );
            (1..=self.peers.len()).for_each(|n| t += &format!(" | {:>7}", format!("x [{n}]")));
            t += if self.costs.is_empty() { "\n" } else { " |    cost\n" };
            set.kernels.iter().for_each(|row| t += &row.line(width));
            for p in &set.peers {
                let what = self.peer_label(p);
                let _ = writeln!(t, "{what:width$} {:8.3} {:9} |", p.mrays_per_second, p.hits);
            }
        }
        t.push('\n');
        t + &self.summary().iter().map(|line| format!("{line}\n")).collect::<String>()
    }

    fn peer_label(&self, row: &PeerRow) -> String {
        format!("  {}, {}", self.peers[row.peer], threads(row.threads))
    }

    /// Width of the table's first column.
    fn first_column(&self) -> usize {
        let rows = |set: &Set| {
            let labels = set.kernels.iter().map(Row::label).chain(set.peers.iter().map(|p| self.peer_label(p)));
            labels.chain([set.title()]).map(|text| text.chars().count()).max()
        };
        self.sets.iter().filter_map(rows).max().unwrap_or(0)
    }

    /// Geometric means and costs, a line each.
    fn summary(&self) -> Vec<String> {
        let mean = |m: &Mean| {
            format!(
                "{} {}, {}: {:.3} x {} (geometric mean of {} sets; least {:.3}, {})",
                m.kernel,
                m.isa,
                threads(m.threads),
                m.geometric_mean,
                self.peers[m.peer],
                m.sets,
                m.least,
                m.least_set
            )
        };
        let cost = |c: &Cost| {
            let way = format!("{} {}, {}", c.kernel, c.isa, threads(c.threads));
            format!("{way}: exactness costs {:.1} % (geometric mean of {} sets)", c.percent, c.sets)
        };
        self.means.iter().map(mean).chain(self.costs.iter().map(cost)).collect()
    }

    /// As Markdown: a row for each set and kernel.
    pub fn markdown(&self) -> String {
        let mut t = format!(
            "`{}`: {} triangles, {:.2} bytes each. {}; medians of {} rounds in turn{}.\n\n",
            self.model,
            self.triangles,
            self.bytes_per_triangle,
            self.machine,
            self.rounds,
            self.clock.note()
        );
        let has_cost = !self.costs.is_empty();
        t += "| rays | kernel | Mrays/s | nodes | leaves | triangles | pages |";
        for peer in &self.peers {
            let _ = write!(t, " x {peer} |");
        }
        t += if has_cost { " cost |\n" } else { "\n" };
        t += "| --- | --- | ---: | ---: | ---: | ---: | ---: |";
        t += &" ---: |".repeat(self.peers.len() + usize::from(has_cost));
        t.push('\n');
        for (set, row) in self.sets.iter().flat_map(|s| s.kernels.iter().map(move |k| (s, k))) {
            let _ = write!(
                t,
                "| {} | {} {}, {} | {:.2} | {:.2} | {:.2} | {:.1} | {:.2} |",
                set.set,
                row.kernel,
                row.isa,
                threads(row.threads),
                row.mrays_per_second,
                row.nodes_per_ray,
                row.leaves_per_ray,
                row.triangles_per_ray,
                row.pages_per_ray
            );
            for ratio in &row.ratios {
                let _ = write!(t, " {ratio:.2} |");
            }
            if has_cost {
                t += &row.cost_percent.map_or(" |".to_owned(), |c| format!(" {c:.1} % |"));
            }
            t.push('\n');
        }
        t.push('\n');
        t + &self.summary().iter().map(|line| format!("- {line}\n")).collect::<String>()
    }
}

impl Set {
    fn title(&self) -> String {
        format!("{}, {} rays, {}", self.set, self.rays, self.question.name())
    }
}

impl Row {
    fn label(&self) -> String {
        format!("  {} {}, {}", self.kernel, self.isa, threads(self.threads))
    }

    /// A line of the table; counts are means over the rays.
    fn line(&self, width: usize) -> String {
        let mut line = format!(
            "{:width$} {:8.3} {:9} | {:6.2} {:6.2} {:9.1} {:6.2} {:7.4}",
            self.label(),
            self.mrays_per_second,
            self.hits,
            self.nodes_per_ray,
            self.leaves_per_ray,
            self.triangles_per_ray,
            self.pages_per_ray,
            self.doubts_per_ray
        );
        self.ratios.iter().for_each(|ratio| line += &format!(" | {ratio:7.3}"));
        if let Some(cost) = self.cost_percent {
            line += &format!(" | {cost:5.1} %");
        }
        if self.differs {
            line += " | ANSWERS DIFFER";
        }
        line + "\n"
    }
}

fn threads(n: usize) -> String {
    if n == 1 { "1 thread".to_owned() } else { format!("{n} threads") }
}
