//! octbench: accuracy, speed and their trade.
#![allow(dead_code)]
mod accuracy;
mod families;
mod oracle;
mod random;
mod yardstick;

fn main() {
    let rays = std::env::args().nth(1).map_or(100_000, |x| x.parse().unwrap());
    let families = std::env::args().skip(2).map(|x| x.parse().unwrap()).collect();
    let plan = accuracy::Plan { rays, families, seed: 1 };
    let start = std::time::Instant::now();
    let reports = accuracy::run(&plan, |r| {
        println!("{:3} {:50} rays {} hits {} wrong {} (missed {} false {} tri {} doubled {} odd {} any {} uv {}) ulp {:?} {:.2} Mr/s", r.number, r.name, r.rays, r.hits, r.disagreements(), r.missed, r.false_hits, r.wrong_triangle, r.doubled, r.odd_crossings, r.wrong_any, r.wrong_uv, r.ulp_histogram, r.mrays_per_second);
        for e in &r.examples { println!("      {e}"); }
    })
    .unwrap();
    println!("{} rays, {} disagreements, {:?}", reports.iter().map(|r| r.rays).sum::<u64>(), reports.iter().map(|r| r.disagreements()).sum::<u64>(), start.elapsed());
}
