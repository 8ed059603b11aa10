"""Evaluation on real photographs and on pictures of another renderer: skylines, and positions from them."""
