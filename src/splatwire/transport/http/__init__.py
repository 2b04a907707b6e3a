"""HTTP server for the browser page and its streams, and pages that contain their streams in one HTML file."""
