"""The figures of ``docs/how-it-works.md``: ``python -m generate.figures`` draws them all, with the code that searches."""
