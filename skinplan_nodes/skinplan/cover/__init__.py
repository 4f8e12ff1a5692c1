"""The least number of columns that cover all rows, with proof."""
