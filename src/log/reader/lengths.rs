//! Checks the lengths inside a record before the mcap crate sees it.
//!
//! That crate takes memory for a text as long as its length says, up to 4 GiB, and panics on an
//! attachment whose parts do not add up.

use mcap::records::op;

/// Bytes before a record's body: its kind and the body's length.
pub(super) const HEAD: usize = 1 + 8;

/// Checks that the parts of a record fit into it. The error says what does not.
pub(super) fn check(kind: u8, body: &[u8]) -> Result<(), String> {
    let mut parts = Rest(body);
    let fit = match kind {
        op::HEADER => parts.text().and_then(|()| parts.text()),
        op::SCHEMA => parts.schema(),
        op::CHANNEL => parts.channel(),
        op::MESSAGE => parts.skip(2 + 4 + 8 + 8),
        op::METADATA => parts.text().and_then(|()| parts.map()),
        op::ATTACHMENT => parts.attachment(),
        op::CHUNK => parts.chunk(),
        _ => Some(()),
    };
    fit.ok_or_else(|| {
        let size = body.len();
        format!("the lengths inside a record of kind {kind:#04x} and {size} bytes do not add up")
    })
}

/// What is left of a record; each step is `None` if it would go beyond the end.
struct Rest<'a>(&'a [u8]);

impl Rest<'_> {
    fn skip(&mut self, bytes: usize) -> Option<()> {
        self.0 = self.0.get(bytes..)?;
        Some(())
    }

    fn length(&mut self) -> Option<usize> {
        let (length, rest) = self.0.split_first_chunk::<4>()?;
        self.0 = rest;
        usize::try_from(u32::from_le_bytes(*length)).ok()
    }

    /// A length of four bytes, then as many bytes.
    fn text(&mut self) -> Option<()> {
        let length = self.length()?;
        self.skip(length)
    }

    /// A length of four bytes, then pairs of texts that fill it exactly.
    fn map(&mut self) -> Option<()> {
        let length = self.length()?;
        let mut pairs = Rest(self.0.get(..length)?);
        while !pairs.0.is_empty() {
            pairs.text()?;
            pairs.text()?;
        }
        self.skip(length)
    }

    fn schema(&mut self) -> Option<()> {
        self.skip(2)?; // number
        self.text()?; // name
        self.text()?; // encoding
        self.text() // definition
    }

    fn channel(&mut self) -> Option<()> {
        self.skip(2 + 2)?; // numbers of channel and schema
        self.text()?; // topic
        self.text()?; // encoding
        self.map()
    }

    fn attachment(&mut self) -> Option<()> {
        self.skip(8 + 8)?; // stamps
        self.text()?; // name
        self.text()?; // media type
        let (length, rest) = self.0.split_first_chunk::<8>()?;
        // The data, and a checksum of four bytes.
        (u64::from_le_bytes(*length).checked_add(4)? == rest.len() as u64).then_some(())
    }

    fn chunk(&mut self) -> Option<()> {
        self.skip(8 + 8 + 8 + 4)?; // stamps, size, checksum
        self.text()?; // compression
        self.skip(8) // compressed size
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_has_to_be_filled_exactly() {
        let pair = [1, 0, 0, 0, b'k', 1, 0, 0, 0, b'v'];
        let metadata = |length: u8, pairs: &[u8]| {
            let mut body = vec![0, 0, 0, 0, length, 0, 0, 0];
            body.extend_from_slice(pairs);
            check(op::METADATA, &body)
        };
        assert!(metadata(10, &pair).is_ok());
        assert!(metadata(0, &[]).is_ok());
        assert!(metadata(9, &pair).is_err());
        assert!(metadata(11, &pair).is_err());
        let mut long = pair;
        long[8] = 0xff;
        assert!(metadata(10, &long).is_err());
    }
}
