"""The project's site: its pages, a gallery of executed examples, and references, from the checkout alone."""
