//! A message as bytes and back: CDR, the little-endian form that ROS 2 writes.
//!
//! Four bytes say the byte order, then come the fields without names; a number is aligned to its
//! size, counted from after those four bytes.
//!
//! Decoding is safe on any bytes: a length that promises more than there is ends in an error
//! before memory is taken for it, so memory stays within a small multiple of the input (at worst
//! a list of empty strings, 4 bytes each in the input and 24 in memory, doubled as it grows).

use byteorder::LittleEndian;

use super::{LogError, Message};

/// Representation identifier of plain little-endian CDR, and two bytes of options.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Zeros that another writer may add at the end, to a multiple of four.
const MOST_PADDING: usize = 3;

/// Encodes a message.
///
/// # Errors
/// [`LogError::Encode`] if a field has no CDR form (none of the types of [`super::messages`]).
pub fn encode<M: Message>(message: &M) -> Result<Vec<u8>, LogError> {
    let mut bytes = Vec::new();
    encode_into(message, &mut bytes)?;
    Ok(bytes)
}

/// Encodes a message into a buffer, whose content it replaces; saves the allocation.
///
/// # Errors
/// As [`encode`].
pub fn encode_into<M: Message>(message: &M, bytes: &mut Vec<u8>) -> Result<(), LogError> {
    bytes.clear();
    bytes.extend_from_slice(&ENCAPSULATION);
    cdr_encoding::to_writer::<M, LittleEndian, _>(bytes, message)
        .map_err(|cause| LogError::Encode { message: M::TYPE, cause: cause.to_string() })
}

/// Decodes a message.
///
/// # Errors
/// [`LogError::Decode`] if the bytes are not exactly one message of this type.
pub fn decode<M: Message>(bytes: &[u8]) -> Result<M, LogError> {
    let failed = |cause: String| LogError::Decode { message: M::TYPE, bytes: bytes.len(), cause };
    let Some((encapsulation, body)) = bytes.split_first_chunk::<4>() else {
        return Err(failed("the four bytes that say the byte order are missing".into()));
    };
    if encapsulation[..2] != ENCAPSULATION[..2] {
        return Err(failed(format!(
            "the byte order is {:02x}{:02x}, but only 0001 (little-endian CDR) is supported",
            encapsulation[0], encapsulation[1]
        )));
    }
    let (message, used) =
        cdr_encoding::from_bytes::<M, LittleEndian>(body).map_err(|cause| failed(cause.to_string()))?;
    let rest = body.len().saturating_sub(used);
    if rest > MOST_PADDING {
        return Err(failed(format!("{rest} bytes are left over after the last field")));
    }
    Ok(message)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::messages::{Decision, Header, Image, PoseStamped};

    #[test]
    fn alignment_counts_from_after_the_encapsulation() {
        let decision = Decision {
            header: Header::new(1_000_000_002, "ab"),
            frame: 3,
            action_index: 4,
            action: 1,
            behaviour: 0,
            task: String::new(),
            epoch: 5,
            q_values: vec![1.0],
            reflex: true,
        };
        let mut expected = vec![0, 1, 0, 0];
        expected.extend([1, 0, 0, 0, 2, 0, 0, 0]); // stamp
        expected.extend([3, 0, 0, 0, b'a', b'b', 0]); // frame_id with its terminator, to 15
        expected.push(0); // to 16, a multiple of 8
        expected.extend(3u64.to_le_bytes());
        expected.extend(4u64.to_le_bytes());
        expected.extend([1, 0, 0, 0]); // action, behaviour, to 36
        expected.extend([1, 0, 0, 0, 0, 0, 0, 0]); // an empty string is its terminator; to 44
        expected.extend([5, 0, 0, 0, 1, 0, 0, 0]); // epoch, number of values; to 52
        expected.extend([0, 0, 0, 0]); // to 56
        expected.extend(1.0f64.to_le_bytes());
        expected.push(1);
        assert_eq!(encode(&decision).unwrap(), expected);
        assert_eq!(decode::<Decision>(&expected).unwrap(), decision);
    }

    #[test]
    fn a_length_beyond_the_end_is_an_error() {
        let mut bytes = encode(&Image { data: vec![7; 8], ..Image::default() }).unwrap();
        let length_at = bytes.len() - 12;
        bytes[length_at..length_at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
        let error = decode::<Image>(&bytes).unwrap_err();
        assert!(matches!(error, LogError::Decode { .. }), "{error}");
    }

    #[test]
    fn bytes_left_over_are_an_error_unless_padding() {
        let mut bytes = encode(&PoseStamped::default()).unwrap();
        bytes.extend([0; 3]);
        assert!(decode::<PoseStamped>(&bytes).is_ok());
        bytes.push(0);
        let error = decode::<PoseStamped>(&bytes).unwrap_err().to_string();
        assert!(error.contains("4 bytes are left over"), "{error}");
    }
}
