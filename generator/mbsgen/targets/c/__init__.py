"""C: one file a kernel, with a header and a manifest."""
