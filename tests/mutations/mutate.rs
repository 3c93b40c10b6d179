//! Changes to bytes that parsers are most likely to stumble over.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Numbers at the edges of what fits, as lengths and sizes.
fn extreme(rng: &mut ChaCha8Rng, near: u64) -> u64 {
    match rng.random_range(0..12) {
        0 => 0,
        1 => 1,
        2 => near.wrapping_sub(1),
        3 => near.wrapping_add(1),
        4 => near.wrapping_mul(2),
        5 => i32::MAX as u64,
        6 => u32::MAX.into(),
        7 => 1 << rng.random_range(8..63),
        8 => i64::MAX as u64,
        9 => u64::MAX,
        10 => rng.random_range(0..4096),
        _ => rng.random(),
    }
}

fn place(rng: &mut ChaCha8Rng, bytes: &[u8]) -> usize {
    rng.random_range(0..bytes.len().max(1))
}

/// One to four changes to one of some inputs.
pub fn bytes(rng: &mut ChaCha8Rng, corpus: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = corpus[rng.random_range(0..corpus.len())].clone();
    for _ in 0..rng.random_range(1..5) {
        change(rng, &mut bytes, corpus);
    }
    bytes
}

fn change(rng: &mut ChaCha8Rng, bytes: &mut Vec<u8>, corpus: &[Vec<u8>]) {
    let at = place(rng, bytes);
    match rng.random_range(0..10) {
        0 | 1 => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte ^= 1 << rng.random_range(0..8)),
        2 => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte = rng.random()),
        // A length or another number, of four or eight bytes.
        3..=5 => {
            let width = if rng.random() { 4 } else { 8 };
            let Some(field) = bytes.get_mut(at..at + width) else { return };
            let mut old = [0; 8];
            old[..width].copy_from_slice(field);
            let new = extreme(rng, u64::from_le_bytes(old)).to_le_bytes();
            field.copy_from_slice(&new[..width]);
        }
        6 => bytes.truncate(at),
        // The beginning of this one, the end of another.
        7 => {
            let other = &corpus[rng.random_range(0..corpus.len())];
            let from = place(rng, other);
            bytes.truncate(at);
            bytes.extend_from_slice(&other[from..]);
        }
        8 => {
            let end = (at + rng.random_range(1..200)).min(bytes.len());
            bytes.drain(at..end);
        }
        _ => {
            let end = (at + rng.random_range(1..200)).min(bytes.len());
            let again = bytes[at..end].to_vec();
            bytes.splice(at..at, again);
        }
    }
}

/// Changes to a length of a log's record, or inside of one; otherwise as [`bytes`].
pub fn log(rng: &mut ChaCha8Rng, corpus: &[Vec<u8>], records: impl Fn(&[u8]) -> Vec<(usize, u8, usize)>) -> Vec<u8> {
    if rng.random_range(0..3) > 0 {
        return bytes(rng, corpus);
    }
    let mut log = corpus[rng.random_range(0..corpus.len())].clone();
    for _ in 0..rng.random_range(1..4) {
        let found = records(&log);
        let Some(&(at, _, length)) = found.get(place(rng, &log) % found.len().max(1)) else { continue };
        // The record's own length, its kind, or a number near its beginning.
        match rng.random_range(0..4) {
            0 => log[at + 1..at + 9].copy_from_slice(&extreme(rng, length as u64).to_le_bytes()),
            1 => log[at] = rng.random(),
            2 => {
                let field = at + 9 + rng.random_range(0..60);
                let Some(field) = log.get_mut(field..field + 4) else { continue };
                let new = extreme(rng, length as u64).to_le_bytes();
                field.copy_from_slice(&new[..4]);
            }
            _ => {
                // A record leaves, or comes twice.
                let end = (at + 9).saturating_add(length).min(log.len());
                let record: Vec<u8> = log.drain(at..end).collect();
                if rng.random() {
                    log.splice(at..at, [record.clone(), record].concat());
                }
            }
        }
    }
    log
}

/// Values that a text may hold in place of a number.
const VALUES: [&str; 26] = [
    "0",
    "-1",
    "1",
    "1e999",
    "-1e308",
    "1e308",
    "nan",
    "-inf",
    "0.0000000001",
    "9223372036854775807",
    "18446744073709551616",
    "0x7fffffffffffffff",
    "1_000",
    "99999",
    "true",
    "\"auto\"",
    "\"\"",
    "'x'",
    "[]",
    "[[]]",
    "[[0.0, 0.0], [1e300, -1e300]]",
    "{}",
    "{ a = 1 }",
    "1979-05-27T07:32:00Z",
    "\"\\u0000\"",
    "\u{fffd}",
];

/// Replace a number of a text.
pub fn number(rng: &mut ChaCha8Rng, text: &mut Vec<u8>, within: usize) {
    let end = within.min(text.len());
    let start = place(rng, &text[..end]);
    let Some(at) = (start..end).find(|&at| text[at].is_ascii_digit()) else { return };
    let number = |byte: &u8| byte.is_ascii_digit() || b".-e_".contains(byte);
    let length = text[at..].iter().take_while(|byte| number(byte)).count();
    text.splice(at..at + length, VALUES[rng.random_range(0..VALUES.len())].bytes());
}

/// Changes to a checkpoint: numbers of its header, whose length then fits or does not; otherwise as [`bytes`].
pub fn checkpoint(rng: &mut ChaCha8Rng, corpus: &[Vec<u8>]) -> Vec<u8> {
    if rng.random_range(0..3) == 0 {
        return bytes(rng, corpus);
    }
    let whole = &corpus[rng.random_range(0..corpus.len())];
    let header = u64::from_le_bytes(whole[..8].try_into().expect("a checkpoint begins with a length")) as usize;
    let mut text = whole[8..8 + header].to_vec();
    for _ in 0..rng.random_range(1..4) {
        if rng.random_range(0..4) == 0 {
            change(rng, &mut text, corpus);
        } else {
            // Shapes and places of tensors stand outside of the scenario's text.
            let within = text.len();
            number(rng, &mut text, within);
        }
    }
    let length = if rng.random_range(0..10) == 0 { extreme(rng, header as u64) } else { text.len() as u64 };
    [&length.to_le_bytes()[..], &text, &whole[8 + header..]].concat()
}

/// Changes to a scenario: lines and values; otherwise as [`bytes`].
pub fn scenario(rng: &mut ChaCha8Rng, corpus: &[Vec<u8>]) -> Vec<u8> {
    if rng.random_range(0..4) == 0 {
        return bytes(rng, corpus);
    }
    let mut text = corpus[rng.random_range(0..corpus.len())].clone();
    for _ in 0..rng.random_range(1..6) {
        let mut lines: Vec<Vec<u8>> = text.split(|byte| *byte == b'\n').map(<[u8]>::to_vec).collect();
        let line = rng.random_range(0..lines.len());
        let other = rng.random_range(0..lines.len());
        match rng.random_range(0..9) {
            0 => drop(lines.remove(line)),
            1 => lines.insert(line, lines[other].clone()),
            2 => lines.swap(line, other),
            3 => {
                let key = lines[line].iter().position(|byte| *byte == b'=').map_or(0, |at| at + 1);
                lines[line].truncate(key);
                lines[line].extend(VALUES[rng.random_range(0..VALUES.len())].bytes());
            }
            4 => {
                // The key of one line, the value of another.
                let value = lines[other].iter().position(|byte| *byte == b'=').map(|at| lines[other][at..].to_vec());
                let key = lines[line].iter().position(|byte| *byte == b'=').unwrap_or(lines[line].len());
                lines[line].truncate(key);
                lines[line].extend(value.unwrap_or_default());
            }
            5 => {
                let depth = 1 << rng.random_range(1..13);
                let (open, close) = if rng.random() { ("[", "]") } else { ("{a=", "}") };
                lines[line] = format!("x = {}{}", open.repeat(depth), close.repeat(depth)).into_bytes();
            }
            6 => lines[line] = format!("[{}]", "a.".repeat(1 << rng.random_range(0..12))).into_bytes(),
            _ => {
                let mut whole = lines.join(&b'\n');
                let within = whole.len();
                number(rng, &mut whole, within);
                text = whole;
                continue;
            }
        }
        text = lines.join(&b'\n');
    }
    text
}
