"""What values say of themselves: any value in, a small table out, as text and for notebooks."""
