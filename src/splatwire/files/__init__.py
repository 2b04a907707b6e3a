"""What every room does with files alike: tell what one is, read it within a limit, name it, write it as a whole."""
