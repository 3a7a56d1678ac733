"""A page that makes motions in the browser, without a server."""
