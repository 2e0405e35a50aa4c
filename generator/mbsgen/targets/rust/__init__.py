"""Rust: one crate a model."""
