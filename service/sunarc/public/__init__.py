"""The names of `import sunarc`, and the functions that they share with the library's commands."""
