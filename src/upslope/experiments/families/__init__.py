"""Studies of families beyond the paper's: what each part of the recipe for any family is worth."""
