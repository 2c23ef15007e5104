//! Why a file was refused.

use core::fmt;

use thiserror::Error;

/// Why a file was refused: where, which key, what is wrong with it and what to write instead.
///
/// It displays as one line: `demo.toml:7: network.loss = 1.5: it must be from 0.0 to 1.0`.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("{file}{place}: {key}{problem}")]
pub struct DocumentError {
    /// The file, as the user named it.
    pub file: String,
    /// Where the value was written.
    pub place: Place,
    /// The key by its whole path, as `--set` takes it; empty where no single key is to blame.
    pub key: String,
    /// What is wrong and the remedy.
    pub problem: Box<Problem>,
}

/// Where a value was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// In the file, on this line, counted from 1.
    Line(usize),
    /// On the command line, with this argument of `--set`.
    Set(String),
    /// Nowhere: the file as a whole lacks it.
    File,
}

/// What is wrong with a file. Each displays as the rest of a line that begins with the key, and says what to write instead.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum Problem {
    /// Not TOML.
    #[error("this is not TOML: {0}")]
    Syntax(String),
    /// An argument of `--set` that leads nowhere.
    #[error("{0}")]
    Path(String),
    /// A key that means nothing.
    #[error(" is an unknown key{hint}")]
    Unknown {
        /// The nearest known key, or all of them.
        hint: String,
    },
    /// A key that must be given.
    #[error(" is missing: add `{example}`")]
    Missing {
        /// What to add.
        example: &'static str,
    },
    /// Text where a number belongs, and the like.
    #[error(" = {value}: it must be {expected}{hint}")]
    Kind {
        /// What is written there.
        value: String,
        /// What belongs there.
        expected: &'static str,
        /// What to change, if that is plain.
        hint: &'static str,
    },
    /// A number outside its range, or not finite.
    #[error(" = {value}: it must be {must}")]
    Range {
        /// What is written there.
        value: String,
        /// The range in words.
        must: String,
    },
    /// A word that is none of the known ones.
    #[error(" = {value}: there is no such {what}{hint}")]
    Name {
        /// What is written there.
        value: String,
        /// What the word names.
        what: &'static str,
        /// The nearest known one, or all of them.
        hint: String,
    },
    /// A value that is possible by itself and refused for another reason.
    #[error(" = {value}: {why}")]
    Refused {
        /// What is written there.
        value: String,
        /// Why, and the remedy.
        why: String,
    },
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(line) => write!(f, ":{line}"),
            Self::Set(argument) => write!(f, " with --set {argument}"),
            Self::File => Ok(()),
        }
    }
}

/// What a reader returns: the value, or the place, key and reason of the refusal.
pub type Read<T> = Result<T, Refusal>;

/// A refusal without the file's name, which the top adds once.
#[derive(Debug, Error)]
#[error("{key}{problem}")]
pub struct Refusal {
    /// Where the value was written.
    pub place: Place,
    /// The key by its whole path.
    pub key: String,
    /// What is wrong and the remedy.
    pub problem: Box<Problem>,
}

impl Refusal {
    /// The refusal of the key at the path `key`, written at `place`.
    pub fn new(place: &Place, key: &str, problem: Problem) -> Self {
        Self {
            place: place.clone(),
            key: key.to_owned(),
            problem: Box::new(problem),
        }
    }
    /// The refusal as an error of `file`, as the user named it.
    pub fn in_file(self, file: &str) -> DocumentError {
        DocumentError {
            file: file.to_owned(),
            place: self.place,
            key: self.key,
            problem: self.problem,
        }
    }
}
