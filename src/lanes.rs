//! Work compiled for each kind of processor.
//!
//! Every operation is one IEEE operation, rounded alike on every processor (no fused multiply-add, no estimates): only
//! how many are done at a time differs, so that results are the same bits everywhere.
//!
//! This file holds the only `unsafe` code outside of foreign interfaces: the calls of functions compiled for more than
//! the oldest processor.

/// Work that is compiled for each kind of processor; whatever it calls and is to profit must be inlined into it.
pub trait Kernel {
    type Output;
    fn run(self, lanes: impl Lanes) -> Self::Output;
}

/// A kind of processor.
pub trait Lanes: Copy {}

/// Any processor.
#[derive(Clone, Copy)]
struct Arrays;

impl Lanes for Arrays {}

/// Runs `kernel` in the widest registers that this processor has.
#[inline]
pub fn run<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    {
        let has_avx512 = std::arch::is_x86_feature_detected!("avx512f")
            && std::arch::is_x86_feature_detected!("avx512dq")
            && std::arch::is_x86_feature_detected!("avx512vl");
        if has_avx512 {
            // SAFETY: as detected.
            return unsafe { for_avx512(kernel) };
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: as detected.
            return unsafe { for_avx2(kernel) };
        }
    }
    kernel.run(Arrays)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,avx512f,avx512dq,avx512vl")]
fn for_avx512<K: Kernel>(kernel: K) -> K::Output {
    kernel.run(Arrays)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn for_avx2<K: Kernel>(kernel: K) -> K::Output {
    kernel.run(Arrays)
}
