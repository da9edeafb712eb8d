"""flora-led: both lamp strips as one chain of 288 pixels."""
