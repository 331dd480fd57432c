"""What plots show, as plain data: the print figures and the page draw the same."""
