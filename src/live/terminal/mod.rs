//! A run in the terminal.

mod draw;
mod picture;
mod room;

use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use thiserror::Error;

use super::view::{View, Watcher};
use crate::log::LogError;
use draw::draw;

/// Time between two pictures.
const REDRAW: Duration = Duration::from_millis(200);

/// Longest time that the log is read at a time: keys are looked at in between.
const READ: Duration = Duration::from_millis(100);

/// Longest time that a key is waited for.
const KEY: Duration = Duration::from_millis(40);

/// Size of a picture as plain text, columns and lines.
const PLAIN: (u16, u16) = (110, 40);

/// Why a run cannot be watched.
#[derive(Debug, Error)]
pub enum WatchError {
    /// The log cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The terminal fails.
    #[error("the terminal fails: {0}")]
    Terminal(#[from] io::Error),
}

/// What the keys have chosen.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Choice {
    /// Which map is shown: tasks first, then features.
    pub map: usize,
    /// No colours: shades are letters.
    pub plain: bool,
}

/// What a key asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum KeyCommand {
    Leave,
    NextMap,
    LastMap,
    Nothing,
}

fn wish(key: KeyEvent) -> KeyCommand {
    match key.code {
        _ if key.kind == KeyEventKind::Release => KeyCommand::Nothing,
        KeyCode::Char('q') | KeyCode::Esc => KeyCommand::Leave,
        // In this mode the terminal does not make a signal of it.
        KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => KeyCommand::Leave,
        KeyCode::Tab | KeyCode::Right | KeyCode::Char('m') => KeyCommand::NextMap,
        KeyCode::BackTab | KeyCode::Left => KeyCommand::LastMap,
        _ => KeyCommand::Nothing,
    }
}

/// Show a run folder or a log file until somebody leaves, or `stop` is set. The terminal is as before afterwards, also after a
/// panic.
///
/// # Errors
/// See [`WatchError`].
pub fn watch(place: &Path, stop: &AtomicBool) -> Result<(), WatchError> {
    let mut watcher = Watcher::new(place);
    // What cannot be opened is said before the screen is taken.
    watcher.read_on(READ)?;
    let mut terminal = ratatui::try_init()?;
    let watched = show(&mut terminal, &mut watcher, stop);
    ratatui::try_restore()?;
    watched
}

fn show(terminal: &mut ratatui::DefaultTerminal, watcher: &mut Watcher, stop: &AtomicBool) -> Result<(), WatchError> {
    let mut choice = Choice::default();
    let mut drawn: Option<Instant> = None;
    while !stop.load(Ordering::Relaxed) {
        watcher.read_on(READ)?;
        if drawn.is_none_or(|drawn| drawn.elapsed() >= REDRAW) {
            let view = watcher.view(None);
            terminal.draw(|frame| draw(frame.buffer_mut(), &view, choice))?;
            drawn = Some(Instant::now());
        }
        if !event::poll(if watcher.is_up_to_date() { KEY } else { Duration::ZERO })? {
            continue;
        }
        match event::read()? {
            Event::Key(key) => match wish(key) {
                KeyCommand::Leave => return Ok(()),
                KeyCommand::NextMap => choice.map = choice.map.wrapping_add(1),
                KeyCommand::LastMap => choice.map = choice.map.wrapping_sub(1),
                KeyCommand::Nothing => continue,
            },
            Event::Resize(..) => {}
            _ => continue,
        }
        // The answer to a key is seen at once.
        drawn = None;
    }
    Ok(())
}

/// One picture of a run as plain text.
///
/// # Errors
/// The log cannot be read.
pub fn once(place: &Path) -> Result<String, WatchError> {
    let mut watcher = Watcher::new(place);
    while !watcher.is_up_to_date() {
        watcher.read_on(READ)?;
    }
    watcher.settle();
    let view = watcher.view(None);
    Ok(plain(&view, PLAIN))
}

/// A view as plain text of so many columns and lines.
pub fn plain(view: &View, (width, height): (u16, u16)) -> String {
    let choice = Choice { plain: true, ..Choice::default() };
    let Ok(mut terminal) = Terminal::new(TestBackend::new(width, height));
    let Ok(frame) = terminal.draw(|frame| draw(frame.buffer_mut(), view, choice));
    text(frame.buffer)
}

fn text(buffer: &Buffer) -> String {
    let line = |y: u16| -> String { (0..buffer.area.width).map(|x| buffer[(x, y)].symbol()).collect() };
    (0..buffer.area.height).map(|y| line(y).trim_end().to_owned() + "\n").collect()
}

#[cfg(test)]
mod tests;
