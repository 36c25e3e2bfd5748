//! The warning about coordinates so large that f32 may not tell vertices apart, with an origin to give.

use glam::DVec3;

use crate::event::Monitor;

use super::BuildOptions;
use super::join::Tally;

/// From this many extents away from zero on, coordinates count as large: then at most 13 of f32's 24 bits are left.
const FAR: f64 = 1024.0;

/// Warns if different vertices came to lie at one place in a mesh that lies far from zero.
///
/// Whether the source's text told them apart is not known here, so the wording leaves that open.
pub(super) fn warn_if_merged(tally: &Tally, options: &BuildOptions, monitor: Monitor<'_>) {
    let Some(origin) = suggestion(tally, options) else { return };
    monitor.warn(format!(
        "{} triangles were dropped because different vertices of theirs have the same coordinates, and the mesh is small \
         for its distance from zero: rounding to single precision may have merged them; build with --origin {} to keep \
         them apart",
        tally.merged, origin
    ));
}

/// An origin to give, if merged vertices and distance suggest one.
pub(super) fn suggestion(tally: &Tally, options: &BuildOptions) -> Option<String> {
    let bounds = tally.all_bounds;
    if tally.merged == 0 || bounds.is_empty() {
        return None;
    }
    let (low, high) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
    let (extent, distance) = ((high - low).max_element(), low.abs().max(high.abs()).max_element());
    let origin = round((low + high) / 2.0 + DVec3::from(options.origin), extent);
    (distance > FAR * extent).then(|| format!("{},{},{}", origin.x, origin.y, origin.z))
}

/// The point, rounded to the power of ten below the extent, or to whole numbers if there is none.
fn round(point: DVec3, extent: f64) -> DVec3 {
    let digits = if extent > 0.0 { (extent.log10().floor() as i32).min(0) } else { 0 };
    if digits < 0 {
        let scale = 10f64.powi(-digits.max(-300));
        return (point * scale).round() / scale;
    }
    let step = if extent > 0.0 { 10f64.powi(extent.log10().floor() as i32) } else { 1.0 };
    (point / step).round() * step
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::geometry::Aabb;

    #[test]
    fn rounds_to_something_short() {
        assert_eq!(round(DVec3::new(4_512_345.6, -123.4, 0.3), 2345.0), DVec3::new(4_512_000.0, 0.0, 0.0));
        assert_eq!(round(DVec3::new(1234.567, 0.0, -1.0), 0.02), DVec3::new(1234.57, 0.0, -1.0));
        assert_eq!(round(DVec3::new(1234.567, 0.0, -1.0), 0.0), DVec3::new(1235.0, 0.0, -1.0));
    }

    #[test]
    fn only_far_meshes_with_merged_vertices_are_told() {
        let place = |at: f32, merged| {
            let bounds = Aabb { min: Vec3::splat(at), max: Vec3::splat(at + 8.0) };
            let mut tally = Tally::new();
            (tally.merged, tally.all_bounds) = (merged, bounds);
            suggestion(&tally, &BuildOptions::default())
        };
        assert_eq!(place(5_000_000.0, 1).as_deref(), Some("5000004,5000004,5000004"));
        assert_eq!(place(5_000_000.0, 0), None);
        assert_eq!(place(1000.0, 1), None);
    }
}
