//! Threads for the actors; the first error of any of them is kept.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{Builder, Scope, ScopedJoinHandle};

use faer::Par;

use super::interleaving::Interleaving;
use crate::agent::error::RunError;
use crate::lock::lock;
use crate::scenario;

/// Threads for the matrix products of an actor. Their bits do not depend on it.
pub fn parallelism(settings: &scenario::Agent) -> Par {
    if settings.threads > 1 { Par::rayon(settings.threads) } else { Par::Seq }
}

/// Starts actors; the first error of any of them is kept.
pub struct Threads<'scope, 'env> {
    pub scope: &'scope Scope<'scope, 'env>,
    pub failed: &'scope Mutex<Option<RunError>>,
    /// Set with the first error, so that the run ends at the next decision.
    pub ended: &'scope AtomicBool,
    /// The actors take turns.
    pub interleaving: Option<&'env Arc<Interleaving>>,
}

impl<'scope> Threads<'scope, '_> {
    /// Start an actor on a thread of its name; joining it gives what it returned, if it did not fail.
    pub fn start<R: Send + 'scope>(
        &self,
        name: &'static str,
        work: impl FnOnce() -> Result<R, RunError> + Send + 'scope,
    ) -> Result<ScopedJoinHandle<'scope, Option<R>>, RunError> {
        let (failed, ended) = (self.failed, self.ended);
        let turn = self.interleaving.map(|interleaving| (interleaving.clone(), interleaving.add(name)));
        let guarded = move || {
            let _entered = turn.as_ref().map(|(interleaving, me)| interleaving.enter(*me));
            let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work));
            let error = match result {
                Ok(Ok(done)) => return Some(done),
                Ok(Err(error)) => error,
                Err(panic) => {
                    let text = panic.downcast_ref::<String>().cloned();
                    let text = text.or_else(|| panic.downcast_ref::<&str>().map(|&text| text.to_owned()));
                    RunError::Panic(name, text.unwrap_or_default())
                }
            };
            lock(failed).get_or_insert(error);
            ended.store(true, Ordering::Relaxed);
            None
        };
        Builder::new().name(name.to_owned()).spawn_scoped(self.scope, guarded).map_err(RunError::Thread)
    }
}
