"""Files on servers: http and https, and the stores that fsspec knows, such as s3 and gs.

addresses : detection of URLs, and their names without passwords and signatures
transport : the interface of connections, and the wait for their results
http_transport, store_transport : connections to web servers, and to the stores of fsspec
errors : errors in words for users
range_reader : a file whose pieces are fetched when they are read
remote_file : `RemoteFile`, a file by its URL, with its temporary copy

fsspec and aiohttp are imported when a file is opened.

Begin with remote_file.
"""
