"""Parts of the experiment `people`, and training on people."""
