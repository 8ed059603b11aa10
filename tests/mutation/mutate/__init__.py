"""Mutation testing: puts one small fault after another into a module and sees whether the tests notice."""
