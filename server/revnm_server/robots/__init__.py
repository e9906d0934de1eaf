"""The robots as the server knows them: what is wanted of them, what they are told, what they say and measure."""
