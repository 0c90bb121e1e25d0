"""Commands around missions of one's own. In: words. Out: files to begin with, campaigns and what they say."""
