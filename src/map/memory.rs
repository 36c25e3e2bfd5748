//! How much memory there is.

/// Bytes of the machine's memory that are free, where the system tells.
pub fn free_memory() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? << 10)
}

/// Half of the memory that is free, for what may take as much as there is; a gigabyte where the system does not tell.
pub fn half_of_free_memory() -> u64 {
    free_memory().map_or(1 << 30, |bytes| bytes / 2)
}
