//! Threads that listen, each to its own kind of topics.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use ros2_client::{Message, Server, Subscription};
use serde::de::DeserializeOwned;

/// How often a thread that hears nothing sees whether it is to end.
const LOOK_INTERVAL: Duration = Duration::from_millis(200);

/// Something that is listened to, until the flag is set.
pub type Ear = Box<dyn FnOnce(Arc<AtomicBool>) -> Pin<Box<dyn Future<Output = ()>>> + Send>;

/// Do something with each message of a topic; those that cannot be decoded are counted as `broken`.
pub fn ear<M: DeserializeOwned + Send + 'static>(
    subscription: Subscription<M>,
    mut take: impl FnMut(M) + Send + 'static,
    mut broken: impl FnMut(String) + Send + 'static,
) -> Ear {
    Box::new(move |over| {
        Box::pin(async move {
            while !over.load(Ordering::Relaxed) {
                match tokio::time::timeout(LOOK_INTERVAL, subscription.async_take()).await {
                    Ok(Ok((message, _))) => take(message),
                    Ok(Err(error)) => broken(error.to_string()),
                    Err(_) => {}
                }
            }
        })
    })
}

/// Answer each call of a service; those that cannot be decoded have no answer.
pub fn answers<Q: Message + Clone + Send + 'static, A: Message + Send + 'static>(
    server: Server<Q, A>,
    answer: impl Fn(Q) -> A + Send + 'static,
) -> Ear {
    Box::new(move |over| {
        Box::pin(async move {
            while !over.load(Ordering::Relaxed) {
                if let Ok(Ok((id, call))) = tokio::time::timeout(LOOK_INTERVAL, server.async_receive_request()).await {
                    // A client that has gone hears nothing.
                    let _ = server.async_send_response(id, answer(call)).await;
                }
            }
        })
    })
}

/// Threads that are told to end, and waited for, when this is dropped.
#[derive(Default)]
pub struct Threads {
    over: Arc<AtomicBool>,
    handles: Vec<JoinHandle<()>>,
}

impl Threads {
    /// One more, which has the flag that tells it to end.
    ///
    /// # Errors
    /// The system has no thread left.
    pub fn spawn(&mut self, name: &str, run: impl FnOnce(Arc<AtomicBool>) + Send + 'static) -> std::io::Result<()> {
        let over = self.over.clone();
        self.handles.push(std::thread::Builder::new().name(name.into()).spawn(move || run(over))?);
        Ok(())
    }

    /// One more, which listens with all of some ears.
    ///
    /// # Errors
    /// The system has no thread left.
    pub fn listen(&mut self, name: &str, ears: Vec<Ear>) -> std::io::Result<()> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build()?;
        self.spawn(name, move |over| {
            let local = tokio::task::LocalSet::new();
            let tasks: Vec<_> = ears.into_iter().map(|ear| local.spawn_local(ear(over.clone()))).collect();
            runtime.block_on(local.run_until(async {
                for task in tasks {
                    // A task that panicked is silent from now on, and silence stops the robot.
                    let _ = task.await;
                }
            }));
        })
    }
}

impl Drop for Threads {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        for thread in self.handles.drain(..) {
            // One that panicked was silent.
            let _ = thread.join();
        }
    }
}

/// Drop our ends of a network that is dead, on a thread that nobody waits for: RustDDS may take a while, or wait for itself.
pub fn leave(left: impl Send + 'static) {
    // Without a thread, it is left where it is.
    let left = std::mem::ManuallyDrop::new(left);
    let _ =
        std::thread::Builder::new().name("leave".into()).spawn(move || drop(std::mem::ManuallyDrop::into_inner(left)));
}
