//! MAVLink's checksum, CRC-16/MCRF4XX: polynomial 0x1021 reflected, all ones at first, nothing inverted.
//!
//! Eight bytes at a time ("slicing"): a byte's remainder waits for the one before it, eight table entries do not.

/// The checksum of `bytes`, the frame between its start byte and its checksum, followed by the message's own byte `extra`.
pub(super) fn checksum(bytes: &[u8], extra: u8) -> u16 {
    let (chunks, rest) = bytes.as_chunks::<8>();
    let whole = chunks.iter().fold(u16::MAX, |sum, chunk| {
        let [low, high] = sum.to_le_bytes();
        let mut next = TABLES[7][usize::from(chunk[0] ^ low)];
        next ^= TABLES[6][usize::from(chunk[1] ^ high)];
        for (byte, table) in chunk[2..].iter().zip(TABLES[..6].iter().rev()) {
            next ^= table[usize::from(*byte)];
        }
        next
    });
    let rest = rest.iter().chain(core::iter::once(&extra));
    rest.fold(whole, |sum, byte| {
        let [low, high] = sum.to_le_bytes();
        u16::from(high) ^ TABLES[0][usize::from(byte ^ low)]
    })
}

/// The remainder of each byte with as many zero bytes behind it as the table's number.
static TABLES: [[u16; 256]; 8] = tables();

const fn tables() -> [[u16; 256]; 8] {
    let mut tables = [[0; 256]; 8];
    let mut byte = 0;
    while byte < 256 {
        let mut sum = byte as u16;
        let mut bit = 0;
        while bit < 8 {
            sum = (sum >> 1) ^ if sum & 1 == 0 { 0 } else { POLYNOMIAL };
            bit += 1;
        }
        tables[0][byte] = sum;
        byte += 1;
    }
    let mut zeros = 1;
    while zeros < 8 {
        let mut byte = 0;
        while byte < 256 {
            let sum = tables[zeros - 1][byte];
            tables[zeros][byte] = (sum >> 8) ^ tables[0][(sum & 0xff) as usize];
            byte += 1;
        }
        zeros += 1;
    }
    tables
}

/// 0x1021, the lowest power first.
const POLYNOMIAL: u16 = 0x8408;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_the_mavlink_crate_at_every_length() {
        let mut bytes = Vec::new();
        for length in 0..300_u32 {
            let extra = (length * 37) as u8;
            let expected = mavlink_core::calculate_crc(&bytes, extra);
            assert_eq!(checksum(&bytes, extra), expected, "{length} bytes");
            bytes.push((length.wrapping_mul(2_654_435_761) >> 24) as u8);
        }
    }

    #[test]
    fn check_value_of_the_catalogue() {
        // CRC-16/MCRF4XX of "123456789" is 0x6f91; the last digit goes in as the message's own byte.
        assert_eq!(checksum(b"12345678", b'9'), 0x6f91);
    }
}
