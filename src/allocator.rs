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
    set(32 << 20, 64 << 20);
}

/// Makes the allocator give every array of a quarter of a megabyte or more pages of its own, which go back to the system
/// with it: those of points, and of the sorts that lists begin with. Left to itself glibc soon puts arrays of up to 32 MB
/// between those of neighbour lists, and a third of the memory of a large system is holes.
pub fn keep_large_arrays_apart() {
    set(1 << 18, 1 << 17);
}

/// Arrays of so many bytes have pages of their own; of the others so many free bytes at the end are not given back.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn set(apart: i32, kept: i32) {
    // SAFETY: sets two numbers, which decide nothing but where memory comes from
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, apart);
        libc::mallopt(libc::M_TRIM_THRESHOLD, kept);
    }
}

#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
fn set(_apart: i32, _kept: i32) {}

#[cfg(all(test, target_os = "linux", target_env = "gnu"))]
mod tests {
    use super::*;
    use std::hint::black_box;

    /// Pages that this thread has asked for.
    fn faults() -> i64 {
        // SAFETY: the structure is of numbers, and written to only
        unsafe {
            let mut usage = std::mem::zeroed::<libc::rusage>();
            assert_eq!(libc::getrusage(libc::RUSAGE_THREAD, &mut usage), 0);
            usage.ru_minflt
        }
    }

    #[test]
    fn small_systems_keep_what_they_free() {
        const BYTES: usize = 8 << 20;
        keep_large_arrays_apart();
        suit(SMALL - 1);
        let before = faults();
        (0..20).for_each(|_| drop(black_box(vec![1u8; BYTES])));
        let pages = (BYTES / 4096) as i64;
        assert!(faults() - before < 2 * pages, "{} pages for arrays of {pages}", faults() - before);
    }
}
