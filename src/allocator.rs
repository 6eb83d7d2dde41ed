//! What the allocator does with memory that is given back. It cannot know: small systems ask for as much again within a
//! millisecond, large ones had better leave no holes.

/// Systems with fewer points on a rank are small: holes between their arrays do not matter.
const SMALL: usize = 50_000;

/// To be called where the size of a system is known.
pub fn suit(points: usize) {
    if points < SMALL {
        keep_what_is_freed();
    } else {
        keep_large_arrays_apart();
    }
}

/// Makes the allocator keep freed memory for the next arrays. Each step of Newton's method needs the same ones anew: a sixth
/// of the time went to pages that had just been given back.
fn keep_what_is_freed() {
    set([(Setting::OfTheirOwn, 32 << 20), (Setting::Kept, 64 << 20)]);
}

/// Makes the allocator give every array of a quarter of a megabyte or more pages of its own, which go back to the system
/// with it: those of points, and of the sorts that lists begin with. Left to itself glibc soon puts arrays of up to 32 MB
/// between those of neighbour lists, and a third of the memory of a large system is holes.
pub fn keep_large_arrays_apart() {
    set([(Setting::OfTheirOwn, 1 << 18), (Setting::Kept, 1 << 17)]);
}

enum Setting {
    /// Arrays of so many bytes have pages of their own.
    OfTheirOwn,
    /// So many free bytes at the end are not given back.
    Kept,
}

fn set(settings: [(Setting, i32); 2]) {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    for (setting, bytes) in settings {
        let setting = match setting {
            Setting::OfTheirOwn => libc::M_MMAP_THRESHOLD,
            Setting::Kept => libc::M_TRIM_THRESHOLD,
        };
        // SAFETY: sets a number that allocations under way read once
        unsafe { libc::mallopt(setting, bytes) };
    }
    #[cfg(not(all(target_os = "linux", target_env = "gnu")))]
    let _ = settings;
}
