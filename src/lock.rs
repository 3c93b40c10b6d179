//! Mutexes, whoever panicked with one.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// What a thread that panicked has left is used all the same.
pub fn lock<T: ?Sized>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}
