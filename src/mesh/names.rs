//! Names, numbered from 0 in the order in which they first come; compact, since a file may have a million.
//!
//! All text lies in one string, and an open-addressing table holds numbers alone: about 12 bytes a name beside its text.

use xxhash_rust::xxh3::xxh3_64;

/// A set of names with their numbers.
#[derive(Debug, Default)]
pub(super) struct Names {
    text: String,
    /// Where each name ends.
    ends: Vec<u32>,
    /// Numbers counted from 1, 0 = free; as many as a power of two, at most three quarters taken.
    places: Vec<u32>,
}

impl Names {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// Bytes of all names together.
    pub fn text_bytes(&self) -> u64 {
        self.text.len() as u64
    }

    /// Bytes that all of it takes.
    pub fn bytes(&self) -> u64 {
        self.text.capacity() as u64 + 4 * (self.ends.capacity() + self.places.len()) as u64
    }

    /// The name of that number, which must be below [`Names::len`].
    pub fn name(&self, number: usize) -> &str {
        let start = if number == 0 { 0 } else { self.ends[number - 1] };
        &self.text[start as usize..self.ends[number] as usize]
    }

    /// All names in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &str> {
        (0..self.len()).map(|number| self.name(number))
    }

    /// The number of a name that is there.
    pub fn get(&self, name: &str) -> Option<usize> {
        let place = self.place(name)?;
        (self.places[place] as usize).checked_sub(1)
    }

    /// The number of a name, which is added if it is new; `None` if all names would pass 4 GiB.
    pub fn number(&mut self, name: &str) -> Option<usize> {
        if 4 * (self.len() + 1) > 3 * self.places.len() {
            self.grow();
        }
        let place = self.place(name)?;
        if let Some(number) = (self.places[place] as usize).checked_sub(1) {
            return Some(number);
        }
        let end = u32::try_from(self.text.len() + name.len()).ok()?;
        self.text.push_str(name);
        self.ends.push(end);
        self.places[place] = self.len() as u32;
        Some(self.len() - 1)
    }

    /// Where a name stands in the table, or would; `None` only while there is no table.
    fn place(&self, name: &str) -> Option<usize> {
        let last = self.places.len().checked_sub(1)?;
        let mut place = xxh3_64(name.as_bytes()) as usize & last;
        while let Some(number) = (self.places[place] as usize).checked_sub(1) {
            if self.name(number) == name {
                break;
            }
            place = (place + 1) & last;
        }
        Some(place)
    }

    fn grow(&mut self) {
        let size = (2 * self.places.len()).max(16);
        // The old table goes before the new one comes.
        self.places = Vec::new();
        self.places = vec![0; size];
        for number in 0..self.len() {
            let free = self.place(self.name(number)).unwrap_or_default();
            self.places[free] = number as u32 + 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_numbered_by_first_use() {
        let mut names = Names::default();
        assert_eq!((names.get("a"), names.len()), (None, 0));
        for round in 0..2 {
            for i in 0..5000 {
                assert_eq!(names.number(&format!("name {i}")), Some(i), "round {round}");
            }
        }
        assert_eq!((names.number(""), names.number("")), (Some(5000), Some(5000)));
        assert_eq!((names.get("name 77"), names.get("name"), names.name(4999)), (Some(77), None, "name 4999"));
        assert_eq!((names.iter().len(), names.iter().last()), (5001, Some("")));
        assert_eq!(names.text_bytes(), names.iter().map(|name| name.len() as u64).sum::<u64>());
        assert!(names.bytes() < names.text_bytes() * 2 + 24 * 5001);
    }
}
