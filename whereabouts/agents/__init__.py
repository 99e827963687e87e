"""The suite's knowledge for programs that reason: tools and resources of the Model Context Protocol."""
