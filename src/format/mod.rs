#![doc = include_str!("FORMAT.md")]

#[cfg(target_endian = "big")]
compile_error!("octree files are read in place, which needs a little-endian machine");

mod checksum;
mod coordinates;
mod encode;
mod head;
mod header;
mod leaf;
mod material;
mod node;
mod pack;
mod page;
mod part;
#[cfg(test)]
mod spec_test;
mod surrogate;
mod validate;
mod validate_top;
mod writer;

pub use checksum::checksum;
pub use coordinates::Coordinates;
pub(crate) use encode::VertexTable;
pub use encode::encode_leaf;
pub use head::{Head, HeadView, validate_heads};
pub use header::{Dropped, Flags, HEADER_BYTES, Header, MAGIC, Section, SectionKind, SplitMode, VERSION};
pub use leaf::{Coding, LEAF_MAX, Leaf, LeafUnit, Points};
pub use material::MaterialRecord;
pub use node::{DEPTH_MAX, Frame, Node, Slot};
pub use pack::{pack, unpack_into};
pub use page::{Brick, LEAF_PADDING, PAGE_HEADER_BYTES, PageHeader, PageId, PageRecord, SideArrays};
pub(crate) use part::is_single;
pub use surrogate::{Moments, Patch, RootBox, Surrogate, cosine_of_sum};
pub use validate::validate_page;
pub(crate) use validate_top::string_at;
pub use validate_top::{
    Entry, Refusal, most_stored, read_header, validate_directory, validate_entry, validate_materials, validate_tree,
};
pub use writer::{MakeTop, OctWriter, Top};
