"""Dark photographs from elsewhere: the content of their files, and the lit or clean pictures of the same views."""
