//! The end of the writer towards the operating system: counts bytes and fails for good.

use std::{
    io::{self, Write},
    sync::{
        Arc, OnceLock,
        atomic::{AtomicU64, Ordering},
    },
};

/// What is known about a sink; shared with the [`LogWriter`](super::LogWriter), since the mcap
/// writer owns the sink itself.
#[derive(Default)]
pub(super) struct SinkState {
    bytes: AtomicU64,
    failure: OnceLock<(io::ErrorKind, String)>,
}

impl SinkState {
    /// Bytes that the sink accepted.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }

    /// The text of the first failure.
    pub(super) fn failure(&self) -> Option<&str> {
        self.failure.get().map(|(_, cause)| cause.as_str())
    }

    /// Records a failure; only the first one is kept.
    pub(super) fn fail(&self, kind: io::ErrorKind, cause: String) {
        // `set` refuses a second value, which is what is wanted.
        let _ = self.failure.set((kind, cause));
    }
}

/// A sink that accepts nothing after its first failure.
///
/// Without it, the mcap writer would add its summary when it is dropped, after half a record.
pub(super) struct GuardedSink<W> {
    inner: W,
    state: Arc<SinkState>,
}

impl<W> GuardedSink<W> {
    pub(super) fn new(inner: W, state: Arc<SinkState>) -> Self {
        Self { inner, state }
    }

    fn check(&self) -> io::Result<()> {
        match self.state.failure.get() {
            Some((kind, cause)) => Err(io::Error::new(*kind, cause.clone())),
            None => Ok(()),
        }
    }

    fn note<T>(&self, result: io::Result<T>) -> io::Result<T> {
        if let Err(cause) = &result
            // The caller repeats an interrupted call.
            && cause.kind() != io::ErrorKind::Interrupted
        {
            self.state.fail(cause.kind(), cause.to_string());
        }
        result
    }
}

impl<W: Write> Write for GuardedSink<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.check()?;
        let result = match self.inner.write(bytes) {
            Ok(0) if !bytes.is_empty() => Err(io::ErrorKind::WriteZero.into()),
            other => other,
        };
        let written = self.note(result)?;
        self.state.bytes.fetch_add(written as u64, Ordering::Relaxed);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.check()?;
        let result = self.inner.flush();
        self.note(result)
    }
}
