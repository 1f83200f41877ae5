"""Export: a compensation as code for the box, proved against Python by running it. One module a target."""
