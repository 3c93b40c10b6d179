//! What makes runs repeatable: named streams of random numbers, one per purpose, so that adding one does not shift the
//! others; and matrix decompositions on one thread, because their bits depend on the number of threads.

use hmac_sha256::Hash;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Let all decompositions (eigenvalues, LU, Cholesky, SVD) of this process run on one thread.
///
/// faer spreads them over all cores unless told otherwise, and its eigenvalues then have other bits for another number of
/// cores. Whoever computes what goes into a digest calls this first.
pub fn fix_parallelism() {
    faer::set_global_parallelism(faer::Par::Seq);
}

/// The generator for one purpose of one run. The same seed and name give the same numbers on every machine.
pub fn stream(seed: u64, name: &str) -> ChaCha8Rng {
    let mut hash = Hash::new();
    hash.update(b"adagio random stream\0");
    hash.update(seed.to_le_bytes());
    hash.update(name.as_bytes());
    ChaCha8Rng::from_seed(hash.finalize())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;

    #[test]
    fn streams_differ_by_name_and_seed_and_repeat() {
        let first = |seed, name: &str| stream(seed, name).random::<u64>();
        assert_eq!(first(1, "motion"), first(1, "motion"));
        assert_ne!(first(1, "motion"), first(1, "camera"));
        assert_ne!(first(1, "motion"), first(2, "motion"));
    }
}
