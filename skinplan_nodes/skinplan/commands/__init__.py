"""Commands of ``skinplan`` that have a module of their own."""
