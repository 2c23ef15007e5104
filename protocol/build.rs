//! Generates the Rust types of `mavlink/sphere.xml` (and of the `common.xml` that it includes) with mavlink-bindgen.

use std::path::Path;
use std::{env, fs};

use mavlink_bindgen::XmlDefinitions;

fn main() {
    let folder = Path::new("mavlink");
    for file in ["sphere.xml", "common.xml"] {
        println!("cargo::rerun-if-changed={}", folder.join(file).display());
    }
    // The generated code asks for features of the crates that mavlink-bindgen comes with.
    println!("cargo::rustc-check-cfg=cfg(feature, values(\"serde\", \"arbitrary\", \"ts-rs\"))");

    let out = env::var("OUT_DIR").expect("cargo sets OUT_DIR");
    let sphere = XmlDefinitions::Files(vec![folder.join("sphere.xml")]);
    mavlink_bindgen::generate(sphere, &out)
        .unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    // Its own mod.rs hides the module behind a feature; inner attributes forbid a plain include!.
    fs::write(
        Path::new(&out).join("dialect.rs"),
        "#[allow(missing_docs, unreachable_pub, non_camel_case_types, clippy::all)]\npub mod sphere;\n",
    )
    .unwrap_or_else(|error| panic!("{out}: {error}"));
}
