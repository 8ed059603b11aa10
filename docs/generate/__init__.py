"""What makes pages, schemas and figures of the documentation from the code, and checks the site that comes of it."""
