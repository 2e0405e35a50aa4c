"""WebAssembly: one module a model, written from the tapes without a compiler."""
