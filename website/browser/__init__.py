"""The page that generates in a browser."""
