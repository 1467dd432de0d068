"""Commands of the shore: the console in a browser, and a stop from a terminal."""
